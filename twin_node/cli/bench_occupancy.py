"""`twin_node bench occupancy`: forecasts of a log, or of a scenario with many seeds, beside the baselines."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin_node.cli.arguments import add_source_options, given_of, whole, with_source_options
from twin_node.cli.output import add_json, print_figures
from twin_node.cli.progress import over
from twin_node.json_text import json_text

if TYPE_CHECKING:
    from twin_node.bench.occupancy import OccupancyBenchParameters


def add_bench_occupancy(benches: Any) -> None:
    """Adds `bench occupancy`."""
    occupancy = benches.add_parser("occupancy", help="score a log's forecasts, beside the baselines")
    occupancy.add_argument("log", type=Path, metavar="LOG", help="a log; with --seeds the name of a scenario")
    occupancy.add_argument(
        "--markers", type=Path, metavar="FILE.trc", help="truth: reference markers, which begin with the log"
    )
    occupancy.add_argument("--hue", type=_hue, metavar="H", help="truth: pixels of this OpenCV hue (orange 8)")
    occupancy.add_argument(
        "--seeds",
        type=whole,
        metavar="N",
        help="simulate the scenario LOG, or four of them (LOG is all), with so many seeds",
    )
    occupancy.add_argument("--first-seed", type=whole, metavar="K", help="with --seeds: the first of them (default 1)")
    add_json(occupancy)
    add_source_options(occupancy)
    occupancy.set_defaults(run=_bench_occupancy)


def _bench_occupancy(options: argparse.Namespace) -> None:
    from twin_node.bench.errors import BenchError
    from twin_node.bench.occupancy import OccupancyBenchParameters, run
    from twin_node.bench.truth import ColourOf
    from twin_node.nodes.chain_parameters import load_parameters
    from twin_node.nodes.topics import parse_remaps

    chain = with_source_options(load_parameters(options.params), options)
    parameters = OccupancyBenchParameters(
        rig=options.rig,
        remaps=parse_remaps(options.remap),
        start_offset_s=options.start_offset or 0.0,
        duration_s=options.duration,
        chain=chain,
    )
    if options.seeds is not None:
        _require_no_log_options(options)
        first = options.first_seed or 1
        _bench_seeds(str(options.log), range(first, first + options.seeds), parameters, options.json)
        return
    if options.first_seed is not None:
        raise BenchError(
            "--first-seed: expected --seeds N beside it, how many from there on; add it, or leave both out"
        )
    _require_log(options.log)
    colour = None if options.hue is None else ColourOf(options.hue)
    bench = run(options.log, options.markers, colour, parameters, over("set"))
    print_figures(bench.as_json(), options.json)


def _require_log(log: Path) -> None:
    """Raises `BenchError` for what is no file but a scenario's name, which is simulated with `--seeds` alone."""
    from twin_node import resources
    from twin_node.bench.errors import BenchError
    from twin_node.errors import TwinError

    if log.exists() or log.suffix:
        return
    try:
        is_scenario = str(log) == "all" or resources.find(f"sim/{log}.yaml").is_file()
    except TwinError:  # neither: reading it as a log tells so
        return
    if is_scenario:
        raise BenchError(f"{log}: expected a log, found a scenario's name; add --seeds N to simulate it")


def _hue(text: str) -> int:
    """A hue as OpenCV counts them."""
    if not text.isdecimal() or int(text) > 179:
        raise argparse.ArgumentTypeError(f"{text}: expected a hue in OpenCV's half degrees, 0 to 179")
    return int(text)


def _require_no_log_options(options: argparse.Namespace) -> None:
    """Raises `BenchError` for what says how a log is read, beside a scenario."""
    from twin_node.bench.errors import BenchError

    given = given_of(options, ("markers", "hue", "rig", "start_offset", "max_rate", "remap"))
    if given:
        raise BenchError(
            f"--seeds: a scenario brings its own truth, rig and rate, and is run from its start; leave out "
            f"{' and '.join(given)}"
        )


def _bench_seeds(scenario: str, seeds: range, parameters: OccupancyBenchParameters, as_json: bool) -> None:
    from twin_node.bench.seeds import ALL, SCENARIOS, run_seeds, table

    names = SCENARIOS if scenario == ALL else (scenario,)
    benches = [run_seeds(name, seeds, parameters, over("seed")) for name in names]
    each = [bench.as_json() for bench in benches]
    figures = {"scenarios": each} if scenario == ALL else each[0]
    print(json_text(figures) if as_json else table(benches))
