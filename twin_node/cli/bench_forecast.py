"""`twin_node bench forecast`: the experts and the bound on trajectories."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import not_negative, positive, refuse_given, seed, with_given
from twin_node.cli.output import add_json, print_figures

NOISE_M = 0.005
FPS = 30.0


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
        "--noise", type=not_negative, metavar="M", help=f"noise added to each coordinate, m (default {NOISE_M:g})"
    )
    forecast.add_argument(
        "--fps",
        type=positive,
        metavar="F",
        help=f"samples per second, about; of a file at most its own (default {FPS:g})",
    )
    forecast.add_argument("--height", type=positive, metavar="M", help="of a BVH's person, m (default 1.75)")
    forecast.add_argument("--joints", nargs="+", metavar="NAME", help="score points whose names hold one")
    forecast.add_argument("--seed", type=seed, metavar="N", help="of the noise (default 0)")
    add_json(forecast)
    forecast.set_defaults(run=_bench_forecast)


def _bench_forecast(options: argparse.Namespace) -> None:
    from twin_node.bench import forecast, forecast_speed, made_up

    if options.file is None:
        refuse_given(options, ("height", "joints"), "expected with a file of trajectories; give one, or leave it out")
    if options.speed:
        why = "expected with trajectories; --speed has a scene of its own: leave one of the two out"
        refuse_given(options, ("noise", "fps", "seed"), why)
    noise_m = NOISE_M if options.noise is None else options.noise
    fps, noise_seed = options.fps or FPS, options.seed or 0
    if options.speed:
        figures = forecast_speed.run().as_json()
    elif options.made_up:
        figures = made_up.run(fps, noise_m, noise_seed).as_json()
    else:
        parameters = forecast.ForecastBenchParameters(fps, noise_m, joints=tuple(options.joints or ()), seed=noise_seed)
        figures = forecast.run(options.file, with_given(parameters, height_m=options.height)).as_json()
    print_figures(figures, options.json)
