"""`twin_node bench refined`: what a better rig is worth in PSNR."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from tqdm import tqdm

from twin_node.cli.arguments import width
from twin_node.cli.output import add_json
from twin_node.json_text import json_text


def add_bench_refined(benches: Any) -> None:
    """Adds `bench refined`."""
    parser = benches.add_parser("refined", help="PSNR in each camera left out, under a rig and under a refined one")
    parser.add_argument("log", type=Path, metavar="LOG", help="a recording of the rig")
    parser.add_argument("before", type=Path, metavar="BEFORE.yaml", help="rig file to begin with")
    parser.add_argument("after", type=Path, metavar="AFTER.yaml", help="rig file of calibrate refine")
    parser.add_argument("--width", type=width, default=240, metavar="PX", help="width of the images (default 240)")
    add_json(parser)
    parser.set_defaults(run=_bench_refined)


def _bench_refined(options: argparse.Namespace) -> None:
    from twin_node.bench.refined import RefinedParameters, run
    from twin_node.rig import load_rig

    before, after = load_rig(options.before).rig, load_rig(options.after).rig
    with tqdm(total=2 * len(before.cameras), unit="model", disable=None) as bar:
        bench = run(options.log, before, after, RefinedParameters(options.width), bar.update)
    if options.json:
        print(json_text(bench.as_json()))
        return
    for name, score in bench.before.items():
        later = bench.after[name]
        print(
            f"{name}: {score.psnr_db:.2f} to {later.psnr_db:.2f} dB; without shading {score.shading_psnr_db:.2f} to "
            f"{later.shading_psnr_db:.2f} dB ({later.pixels} pixels)"
        )
    raw, shading = bench.gain_db(lambda score: score.psnr_db), bench.gain_db(lambda score: score.shading_psnr_db)
    print(f"mean gain {raw:+.2f} dB, without shading {shading:+.2f} dB")
