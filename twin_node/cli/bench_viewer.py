"""`twin_node bench viewer`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import yaml


def add_bench_viewer(benches: Any) -> None:
    """Adds `viewer` to the benches."""
    viewer = benches.add_parser("viewer", help="how soon and how often the viewer shows what moves")
    viewer.add_argument("log", type=Path, nargs="?", metavar="LOG", help="a twin's log: also time its first picture")
    viewer.add_argument("--json", action="store_true", help="print one JSON object")
    viewer.set_defaults(run=_bench_viewer)


def _bench_viewer(options: argparse.Namespace) -> None:
    from twin_node.bench.viewer import run

    figures = run(options.log).as_json()
    print(json.dumps(figures) if options.json else yaml.safe_dump(figures, sort_keys=False).rstrip())
