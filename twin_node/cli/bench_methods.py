"""`twin_node bench methods`: all ways to a dynamic scene in one table."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import file_or_name, refuse_given, whole, width, with_given
from twin_node.cli.output import add_json
from twin_node.json_text import json_text

if TYPE_CHECKING:
    from twin_node.bench.methods.protocol import Budget
    from twin_node.bench.methods.table import MethodsBench, Report

MADE_UP = "made-up"
"""Stands for the scene that the bench makes itself."""
DATA_WIDTH = 160
"""Width of recorded images unless told otherwise, px: that of the made-up scene."""


def add_methods(benches: Any) -> None:
    """Adds `methods` to the benches."""
    methods = benches.add_parser("methods", help="all methods on the same images: quality, time, size, tracks")
    methods.add_argument(
        "data",
        type=file_or_name,
        nargs="?",
        default=MADE_UP,
        metavar="DATA",
        help="log or data set folder (default: a made-up scene)",
    )
    methods.add_argument("--quick", action="store_true", help="small and short: shows that all methods run")
    methods.add_argument("--methods", metavar="A,B", help="only these; a wrong name lists them all")
    methods.add_argument("--hold-out", action="append", metavar="CAMERA", help="score on this camera; repeatable")
    methods.add_argument("--width", type=width, metavar="PX", help="width of the images")
    methods.add_argument("--frames", type=whole, metavar="N", help="take the first N time steps only")
    methods.add_argument("--steps", type=whole, metavar="N", help="steps of the offline methods")
    methods.add_argument("--rig", type=Path, metavar="RIG.yaml", help="calibration, instead of the log's own")
    methods.add_argument("--out", type=Path, metavar="DIR", help="write methods.json and methods.png here")
    add_json(methods)
    methods.set_defaults(run=_bench_methods)


def _bench_methods(options: argparse.Namespace) -> None:
    from twin_node.bench.methods.chart import draw_chart, text
    from twin_node.bench.methods.protocol import QUICK, Budget
    from twin_node.bench.methods.table import check_names
    from twin_node.bench.results_folder import prepared, save_text

    check_names(_names(options))
    if options.out is not None:
        prepared(options.out)
    budget = QUICK if options.quick else Budget()
    if options.steps is not None:
        nerf = replace(budget.nerf, steps=options.steps)
        budget = replace(budget, offline_steps=options.steps, nerf=nerf)
    with tqdm(total=1.0, disable=None, bar_format="{desc:24}{percentage:3.0f} % [{elapsed}]") as bar:

        def show(name: str, share: float) -> None:
            bar.set_description_str(name, refresh=False)
            bar.n = share
            bar.update(0)

        bench = _made_up(options, budget, show) if options.data == MADE_UP else _recorded(options, budget, show)
    figures = bench.as_json()
    if options.out is not None:
        chart = draw_chart(bench, options.out)
        save_text(chart.parent, f"{chart.stem}.json", json_text(figures, 2) + "\n")
    print(json_text(figures) if options.json else text(bench))


def _made_up(options: argparse.Namespace, budget: Budget, report: Report) -> MethodsBench:
    from twin_node.bench.methods.ablations import ablations
    from twin_node.bench.methods.made_up import MADE_UP_QUICK, MadeUpParameters, make_up
    from twin_node.bench.methods.table import run

    why = "expected with recorded data; the made-up scene has cameras of its own"
    refuse_given(options, ("hold_out", "rig"), why)
    parameters = MADE_UP_QUICK if options.quick else MadeUpParameters()
    parameters = with_given(parameters, width=options.width, frames=options.frames)
    scene = make_up(parameters)
    bench = run(scene.recording, scene.truth, budget, _names(options), report)
    return bench if options.methods else replace(bench, ablations=ablations(parameters, budget, report))


def _recorded(options: argparse.Namespace, budget: Budget, report: Report) -> MethodsBench:
    from twin_node.bench.methods.table import run
    from twin_node.model.sequence import ReadOptions
    from twin_node.nodes.recordings import read_recording
    from twin_node.nodes.synchronizer import SynchronizerParameters

    size = options.width or DATA_WIDTH
    hold_out = None if options.hold_out is None else tuple(options.hold_out)
    reading = ReadOptions(size, options.frames, hold_out)
    recording = read_recording(Path(options.data), reading, SynchronizerParameters(width=size), options.rig)
    return run(recording, None, budget, _names(options), report)


def _names(options: argparse.Namespace) -> tuple[str, ...]:
    from twin_node.bench.methods.table import METHODS

    return tuple(METHODS) if options.methods is None else tuple(options.methods.split(","))
