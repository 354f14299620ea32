"""`twin_node bench forecast`: the experts and the bound on trajectories."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from twin_node.cli.arguments import not_negative, positive, seed
from twin_node.json_text import json_text


def add_bench_forecast(benches: Any) -> None:
    """Adds `bench forecast`."""
    forecast = benches.add_parser(
        "forecast",
        help="score the experts and the bound on 3D trajectories",
        description="Forecasts every point of a file of trajectories 200 ms ahead, sample by sample, and scores the "
        "forecasts beside persistence, constant velocity and the best single expert in hindsight.",
    )
    what = forecast.add_mutually_exclusive_group(required=True)
    what.add_argument("file", nargs="?", type=Path, metavar="FILE", help=".bvh, .trc, or .csv (time,NAME_x,NAME_y,...)")
    what.add_argument("--made-up", action="store_true", help="sudden stops, reversals, throws, ... instead of a file")
    what.add_argument("--speed", action="store_true", help="time a forecast and its cover instead, on a made-up scene")
    forecast.add_argument(
        "--noise",
        type=not_negative,
        default=0.005,
        metavar="M",
        help="noise added to each coordinate, m (%(default)s)",
    )
    forecast.add_argument(
        "--fps", type=positive, default=30.0, metavar="F", help="samples per second, about; of a file at most its own"
    )
    forecast.add_argument("--height", type=positive, metavar="M", help="of a BVH's person, m (default 1.75)")
    forecast.add_argument("--joints", nargs="+", metavar="NAME", help="score points whose names hold one")
    forecast.add_argument("--seed", type=seed, default=0, help="of the noise (%(default)s)")
    forecast.add_argument("--json", action="store_true", help="print one JSON object")
    forecast.set_defaults(run=_bench_forecast)


def _bench_forecast(options: argparse.Namespace) -> None:
    from twin_node.bench import forecast, forecast_speed, made_up

    _require_file(options)
    if options.speed:
        figures = forecast_speed.run().as_json()
    elif options.made_up:
        figures = made_up.run(options.fps, options.noise, options.seed).as_json()
    else:
        parameters = forecast.ForecastBenchParameters(
            fps=options.fps,
            noise_m=options.noise,
            joints=tuple(options.joints or ()),
            seed=options.seed,
        )
        if options.height is not None:
            parameters = replace(parameters, height_m=options.height)
        figures = forecast.run(options.file, parameters).as_json()
    print(json_text(figures) if options.json else yaml.safe_dump(figures, sort_keys=False).rstrip())


def _require_file(options: argparse.Namespace) -> None:
    """Raises `BenchError` for what says how a file is read, without one."""
    from twin_node.bench.errors import BenchError

    given = {"--height": options.height is not None, "--joints": options.joints is not None}
    names = [name for name, is_given in given.items() if is_given]
    if options.file is None and names:
        raise BenchError(f"{' and '.join(names)}: expected with a file of trajectories; give one, or leave it out")
