"""`twin_node bench collision`: measurements of the arm's side."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from tqdm import tqdm

REFERENCE = Path("../shared/data/ur10e_model")
"""Where the UR10e's meshes are looked for: they are other people's, and not part of the project."""


def add_bench_collision(benches: Any) -> None:
    """Adds `bench collision`."""
    collision = benches.add_parser("collision", help="speed of the collision checker, and its clearances beside meshes")
    collision.add_argument(
        "--reference",
        type=Path,
        metavar="DIR",
        help=f"a UR10e's URDF, meshes/*.stl and cuRobo's *.yml (default: {REFERENCE}, where it is there)",
    )
    collision.add_argument("--json", action="store_true", help="print one JSON object")
    collision.set_defaults(run=_bench_collision)


def _bench_collision(options: argparse.Namespace) -> None:
    from twin_node.bench import collision
    from twin_node.bench.arm_reference import ArmReference

    folder = options.reference or (REFERENCE if REFERENCE.is_dir() else None)
    if folder is None:
        print(f"twin_node: warning: no {REFERENCE} here: clearances are not compared", file=sys.stderr)
    reference = None if folder is None else ArmReference(folder)
    figures = collision.run(reference, progress=lambda poses: tqdm(poses, unit="pose", disable=None))
    print(json.dumps(figures) if options.json else collision.table(figures))
