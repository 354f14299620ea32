"""`twin_node bench collision | cell`: measurements of the arm's side."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import file_or_name, given_of, not_negative, positive, whole, with_given
from twin_node.cli.output import add_json, warn
from twin_node.cli.progress import over
from twin_node.json_text import json_text

REFERENCE = Path("../shared/data/ur10e_model")
"""Where the UR10e's meshes are looked for: they are other people's, and not part of the project."""


def add_bench_collision(benches: Any) -> None:
    """Adds `bench collision`."""
    collision = benches.add_parser("collision", help="speed of the collision checker, and its clearances beside meshes")
    collision.add_argument(
        "--reference",
        type=Path,
        metavar="DIR",
        help=f"folder of a UR10e's URDF, its meshes/ and cuRobo's *.yml (default: {REFERENCE}, where it is there)",
    )
    add_json(collision)
    collision.set_defaults(run=_bench_collision)


def add_bench_cell(benches: Any) -> None:
    """Adds `bench cell`."""
    cell = benches.add_parser("cell", help="an arm at work beside people, in closed loop and simulated time")
    cell.add_argument(
        "scenarios",
        type=file_or_name,
        nargs="+",
        metavar="SCENARIO",
        help="scenario files or names below sim/; 'all' for the whole suite",
    )
    cell.add_argument("--seeds", type=whole, metavar="N", help="seeds per scenario (default 20)")
    cell.add_argument("--first-seed", type=whole, metavar="K", help="the first of them (default 1)")
    cell.add_argument(
        "--twin", action="store_true", help="the real chain as 'ours', as late as it is on this machine (slow!)"
    )
    cell.add_argument(
        "--same-eyes", action="store_true", help="with --twin: also the worst case with its perception (twice as slow)"
    )
    cell.add_argument(
        "--latency",
        type=not_negative,
        metavar="MS",
        help="from images to obstacles (default 33; with --twin: measured on one core)",
    )
    cell.add_argument(
        "--set-rate",
        type=positive,
        metavar="HZ",
        help="with --twin --latency: sets per second it takes (default: each when the one before is done)",
    )
    cell.add_argument(
        "--unknown",
        choices=("law", "clearance", "ignore"),
        help="what may come out of space that no camera sees (default law: anything, at 1.6 m/s)",
    )
    cell.add_argument("--processes", type=whole, default=2, metavar="N", help="runs at once (default 2)")
    cell.add_argument(
        "--cameras", action="store_true", help="only measure how fast the cameras of one scenario are rendered"
    )
    cell.add_argument("--out", type=Path, metavar="DIR", help="draw cell.png: work, and the first run's distances")
    add_json(cell)
    cell.set_defaults(run=_bench_cell)


def _bench_cell(options: argparse.Namespace) -> None:
    if options.cameras:
        _bench_cameras(options)
        return
    from twin_node.arm import SeparationParameters, UnknownPolicy
    from twin_node.bench import cell
    from twin_node.bench.cell_picture import draw
    from twin_node.bench.errors import BenchError
    from twin_node.bench.results_folder import prepared
    from twin_node.cell.closed_loop import LoopParameters

    if options.same_eyes and not options.twin:
        raise BenchError("--same-eyes: expected --twin beside it, whose eyes are meant; add it, or leave both out")
    if options.set_rate is not None and (not options.twin or options.latency is None):
        raise BenchError(
            "--set-rate: expected --twin and --latency beside it, for else both are measured; add them, or leave it out"
        )
    names = [name for given in options.scenarios for name in (cell.SUITE if given == "all" else (given,))]
    law = SeparationParameters(unknown=UnknownPolicy(options.unknown or "law"))
    chosen = cell.CellBenchParameters(
        scenarios=tuple(dict.fromkeys(names)),
        twin=options.twin,
        same_eyes=options.same_eyes,
        twin_latency_ms=options.latency if options.twin else None,
        twin_rate_hz=options.set_rate,
        processes=options.processes,
        loop=LoopParameters(separation=law),
    )
    parameters = with_given(chosen, seeds=options.seeds, first_seed=options.first_seed, latency_ms=options.latency)
    if options.out is not None:
        prepared(options.out)
    results = cell.run(parameters, over("run"))
    figures = cell.summary(results)
    if options.out is not None:
        print(f"drawn: {draw(results, parameters, options.out)}", file=sys.stderr)
    print(json_text(figures) if options.json else cell.table(figures))


def _bench_cameras(options: argparse.Namespace) -> None:
    from twin_node.bench.errors import BenchError
    from twin_node.bench.rig_speed import measure
    from twin_node.cell import load_scenario

    if len(options.scenarios) > 1 or options.scenarios == ["all"]:
        found = " ".join(options.scenarios)
        raise BenchError(f"--cameras: expected one scenario, whose cameras are measured, found {found}; give one")
    given = given_of(options, ("seeds", "first_seed", "twin", "same_eyes", "latency", "set_rate", "unknown", "out"))
    if given:
        raise BenchError(f"--cameras: cameras are measured without arm and twin; leave out {' and '.join(given)}")
    figures = asdict(measure(load_scenario(options.scenarios[0]), options.processes))
    print(json_text(figures) if options.json else "\n".join(f"{key}: {value}" for key, value in figures.items()))


def _bench_collision(options: argparse.Namespace) -> None:
    from twin_node.bench import collision
    from twin_node.bench.arm_reference import ArmReference

    folder = options.reference or (REFERENCE if REFERENCE.is_dir() else None)
    if folder is None:
        warn(f"no {REFERENCE} here: clearances are not compared")
    reference = None if folder is None else ArmReference(folder)
    figures = collision.run(reference, progress=over("pose"))
    print(json_text(figures) if options.json else collision.table(figures))
