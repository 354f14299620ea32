"""`twin_node bench viewer`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import refuse_given, whole
from twin_node.cli.output import add_json, print_figures

ROUNDS = 3


def add_bench_viewer(benches: Any) -> None:
    """Adds `viewer` to the benches."""
    viewer = benches.add_parser("viewer", help="how soon and how often the viewer shows what moves, and at what cost")
    viewer.add_argument(
        "log", type=Path, nargs="?", metavar="LOG", help="a twin's log: also its first picture, and sending it"
    )
    viewer.add_argument(
        "--latency", type=Path, metavar="RECORDING", help="instead: replay it in real time with and without visitors"
    )
    viewer.add_argument("--rounds", type=whole, metavar="N", help=f"replays of each kind (default {ROUNDS})")
    viewer.add_argument(
        "-p", "--param", action="append", metavar="NODE.KEY:=VALUE", help="set a parameter of the replays; repeatable"
    )
    add_json(viewer)
    viewer.set_defaults(run=_bench_viewer)


def _bench_viewer(options: argparse.Namespace) -> None:
    from twin_node.bench.errors import BenchError

    if options.latency is not None and options.log is not None:
        raise BenchError(f"--latency: expected instead of a log, found {options.log} too; leave one of the two out")
    if options.latency is None:
        refuse_given(options, ("rounds", "param"), "expected with --latency, whose replays they are of; add it")
    if options.latency is not None:
        from twin_node.bench.viewer_latency import cost

        figures = cost(options.latency, options.rounds or ROUNDS, tuple(options.param or ())).as_json()
    else:
        from twin_node.bench.viewer import run

        figures = run(options.log).as_json()
    print_figures(figures, options.json)
