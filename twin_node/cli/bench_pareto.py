"""`twin_node bench pareto`: speed against accuracy of every method."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from twin_node.cli.arguments import whole


def add_bench_pareto(benches: Any) -> None:
    """Adds `bench pareto`."""
    pareto = benches.add_parser("pareto", help="speed against accuracy: all methods, ours at five sizes")
    pareto.add_argument("logs", nargs="*", type=Path, metavar="LOG", help="recordings beside the made-up scene")
    pareto.add_argument("--quick", action="store_true", help="small and short: shows that all run")
    pareto.add_argument("--frames", type=whole, metavar="N", help="sets of images taken of each log")
    pareto.add_argument("--methods", metavar="A,B", help="only these beside ours; a wrong name lists them")
    pareto.add_argument("--processes", type=whole, metavar="N", help="measured at once, each on one core (default 1)")
    pareto.add_argument("--out", type=Path, metavar="DIR", help="write pareto.json, .md, .png and .svg here")
    pareto.add_argument("--json", action="store_true", help="print one JSON object")
    pareto.set_defaults(run=_bench_pareto)


def _bench_pareto(options: argparse.Namespace) -> None:
    from twin_node.bench.pareto import chart
    from twin_node.bench.pareto.suite import QUICK, ParetoParameters, run

    rivals = None if options.methods is None else tuple(options.methods.split(","))
    given = {"frames": options.frames, "processes": options.processes, "rivals": rivals}
    parameters = replace(
        QUICK if options.quick else ParetoParameters(),
        logs=tuple(options.logs),
        **{name: value for name, value in given.items() if value is not None},
    )
    found = run(parameters, lambda names, total: tqdm(names, total=total, unit="method", disable=None))
    figures = found.as_json()
    if options.out is not None:
        picture = chart.draw(found, options.out)
        picture.with_suffix(".json").write_text(json.dumps(figures, indent=2) + "\n")
        picture.with_suffix(".md").write_text(chart.markdown(found))
    print(json.dumps(figures) if options.json else chart.text(found))
