"""`twin_node bench masks`: what the moving masks of a simulated cell miss, and what they mark besides."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import file_or_name, positive, whole, width
from twin_node.cli.output import add_json
from twin_node.cli.progress import over
from twin_node.json_text import json_text


def add_bench_masks(benches: Any) -> None:
    """Adds `bench masks`."""
    masks = benches.add_parser("masks", help="the moving masks alone, beside what truly moves in a simulated cell")
    masks.add_argument(
        "scenario",
        type=file_or_name,
        metavar="SCENARIO",
        help="a scenario file or name below sim/; 'all': four of them",
    )
    masks.add_argument("--seeds", type=whole, default=1, metavar="N", help="seeds per scenario (default 1)")
    masks.add_argument("--first-seed", type=whole, default=1, metavar="K", help="the first of them (default 1)")
    masks.add_argument(
        "--max-rate", type=positive, metavar="HZ", help="cameras at this rate, if the scenario's is higher"
    )
    masks.add_argument("--width", type=width, default=160, metavar="PX", help="width of the images (default 160)")
    masks.add_argument(
        "--out", type=Path, metavar="DIR", help="draw masks_SCENARIO.png: some images of the first seed, all over time"
    )
    add_json(masks)
    masks.set_defaults(run=_bench_masks)


def _bench_masks(options: argparse.Namespace) -> None:
    from twin_node.bench import masks
    from twin_node.bench.masks_picture import draw
    from twin_node.bench.results_folder import prepared
    from twin_node.cell import load_scenario

    names = masks.SCENARIOS if options.scenario == "all" else (options.scenario,)
    scenarios = [load_scenario(name) for name in names]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    parameters = masks.MasksBenchParameters(options.width, options.max_rate)
    if options.out is not None:
        prepared(options.out)
    benches = []
    for name, scenario in zip(names, scenarios, strict=True):
        found = masks.run(scenario, seeds, parameters, over("set"))
        if options.out is not None:
            print(f"drawn: {draw(found, options.out, f'masks_{Path(name).stem}')}", file=sys.stderr)
        benches.append(found)
    each = [bench.as_json() for bench in benches]
    figures = {"scenarios": each} if options.scenario == "all" else each[0]
    print(json_text(figures) if options.json else masks.table(benches))
