"""`twin_node bench calibration`: made-up rigs against their truth."""

from __future__ import annotations

import argparse
from typing import Any

from tqdm import tqdm

from twin_node.cli.arguments import seed, whole
from twin_node.cli.output import add_json
from twin_node.json_text import json_text


def add_bench_calibration(benches: Any) -> None:
    """Adds `bench calibration`."""
    parser = benches.add_parser("calibration", help="errors of made-up rigs calibrated from a board, against the truth")
    parser.add_argument("--rigs", type=whole, default=50, metavar="N", help="number of made-up rigs (default 50)")
    parser.add_argument("--first-seed", type=seed, default=0, metavar="K", help="seed of the first rig (default 0)")
    parser.add_argument("--processes", type=whole, default=2, metavar="N", help="rigs at once (default 2)")
    add_json(parser)
    parser.set_defaults(run=_bench_calibration)


def _bench_calibration(options: argparse.Namespace) -> None:
    from twin_node.bench import calibration

    bench = calibration.run(
        options.rigs,
        options.first_seed,
        options.processes,
        lambda rigs: tqdm(rigs, total=options.rigs, unit="rig", desc="calibrate", disable=None),
    )
    print(json_text(bench.as_json()) if options.json else bench.table())
