"""`twin_node bench stability`: named failures of rising difficulty."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import whole, with_given
from twin_node.cli.output import add_json
from twin_node.cli.progress import over
from twin_node.json_text import json_text


def add_bench_stability(benches: Any) -> None:
    """Adds `bench stability`."""
    stability = benches.add_parser("stability", help="failures of rising difficulty: where ours and baselines give way")
    stability.add_argument("--quick", action="store_true", help="two levels of each, shorter runs: shows that all run")
    stability.add_argument("--only", nargs="+", metavar="NAME", help="only these failures; a wrong name lists them all")
    stability.add_argument("--seeds", type=whole, default=1, metavar="N", help="runs per level (default 1)")
    stability.add_argument("--processes", type=whole, default=2, metavar="N", help="runs at once (default 2)")
    stability.add_argument("--out", type=Path, metavar="DIR", help="write stability.json, .md, .png and .svg here")
    stability.add_argument("--check", action="store_true", help="end with status 2 where ours fails without a warning")
    add_json(stability)
    stability.set_defaults(run=_bench_stability)


def _bench_stability(options: argparse.Namespace) -> None:
    from twin_node.bench.results_folder import prepared, save_figures
    from twin_node.bench.stability import chart
    from twin_node.bench.stability.suite import QUICK, StabilityParameters, run

    parameters = with_given(
        QUICK if options.quick else StabilityParameters(),
        seeds=options.seeds,
        processes=options.processes,
        names=None if options.only is None else tuple(dict.fromkeys(options.only)),
    )
    if options.out is not None:
        prepared(options.out)
    found = run(parameters, over("run"))
    figures = found.as_json()
    print(json_text(figures) if options.json else chart.text(found))
    if options.out is not None:
        save_figures(options.out, "stability", figures, chart.markdown(found))
        chart.draw(found, options.out)
    if options.check:
        found.check()
