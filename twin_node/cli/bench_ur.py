"""`twin_node bench ur`: how soon the arm stops after each fault."""

from __future__ import annotations

import argparse
from typing import Any

from twin_node.cli.arguments import whole
from twin_node.cli.output import add_json
from twin_node.cli.progress import over
from twin_node.json_text import json_text


def add_bench_ur(benches: Any) -> None:
    """Adds `ur` to the benches."""
    parser = benches.add_parser(
        "ur",
        help="how soon the arm stops after each fault",
        description="Drive a controller stand-in by a simulated twin, inject faults, and measure from the injection "
        "until the arm was told to stop, paused by its own watchdog, or the command was refused.",
    )
    parser.add_argument("--repeats", type=whole, default=20, metavar="N", help="runs of each fault (default 20)")
    parser.add_argument(
        "--fault", action="append", metavar="NAME", help="only this fault; repeatable; a wrong name lists them all"
    )
    add_json(parser)
    parser.set_defaults(run=_bench_ur)


def _bench_ur(options: argparse.Namespace) -> None:
    from twin_node.bench import ur

    names = options.fault or ur.FAULT_NAMES
    bench = ur.run(options.repeats, names, over("fault"))
    if options.json:
        print(json_text(bench.as_json()))
        return
    print(f"{'fault':22}{'p50 ms':>8}{'p99 ms':>8}{'max ms':>8}  reason")
    for name, score in bench.faults.items():
        told = score.answered
        figures = f"{'never':>24}" if told is None else f"{told.p50_ms:8.1f}{told.p99_ms:8.1f}{told.max_ms:8.1f}"
        back = "" if score.driver_back is None else f" (driver back: {score.driver_back.max_ms:.0f} ms at most)"
        print(f"{name:22}{figures}  {score.reason}{back}")
        told_of = ((score.unanswered, "unanswered"), (score.not_latched, "not latched"), (score.not_back, "not back"))
        for count, what in told_of:
            if count:
                print(f"{'':22}{count} of {options.repeats} {what}")
