"""`twin_node bench`: measurements, as text or as one JSON object."""

from __future__ import annotations

import argparse
from typing import Any

from tqdm import tqdm

from twin_node.cli.arguments import add_log, add_source_options, speed, whole, with_source_options
from twin_node.cli.bench_calibration import add_bench_calibration
from twin_node.cli.bench_cell import add_bench_cell, add_bench_collision
from twin_node.cli.bench_forecast import add_bench_forecast
from twin_node.cli.bench_graph import add_bench_graph
from twin_node.cli.bench_masks import add_bench_masks
from twin_node.cli.bench_methods import add_methods
from twin_node.cli.bench_occupancy import add_bench_occupancy
from twin_node.cli.bench_pareto import add_bench_ablations, add_bench_costs, add_bench_length, add_bench_pareto
from twin_node.cli.bench_refined import add_bench_refined
from twin_node.cli.bench_stability import add_bench_stability
from twin_node.cli.bench_ur import add_bench_ur
from twin_node.cli.bench_viewer import add_bench_viewer
from twin_node.cli.output import add_json, print_figures
from twin_node.json_text import json_text


def add_bench(commands: Any) -> None:
    """Adds `bench` to the subcommands."""
    benches = commands.add_parser("bench", help="measure accuracy, speed and safety, beside baselines").add_subparsers(
        required=True, metavar="WHAT"
    )
    add_bench_occupancy(benches)
    track = benches.add_parser("track", help="how well and how fast the model follows a log")
    add_log(track)
    track.add_argument("--rate", type=speed, metavar="R", help="follow in real time at R times the log's pace")
    track.add_argument(
        "--leave-out", metavar="CAMERA", help="score a model that never sees this camera, or all in turn"
    )
    track.add_argument("--bounce", type=whole, default=0, metavar="N", help="N passes, forward and backward in turn")
    add_json(track)
    add_source_options(track)
    track.set_defaults(run=_bench_track)
    add_bench_masks(benches)
    add_methods(benches)
    raster = benches.add_parser("raster", help="speed of the rasteriser's backends")
    add_json(raster)
    raster.set_defaults(run=_bench_raster)
    add_bench_calibration(benches)
    add_bench_refined(benches)
    add_bench_collision(benches)
    add_bench_cell(benches)
    add_bench_forecast(benches)
    add_bench_ur(benches)
    add_bench_graph(benches)
    add_bench_viewer(benches)
    add_bench_stability(benches)
    add_bench_pareto(benches)
    add_bench_ablations(benches)
    add_bench_costs(benches)
    add_bench_length(benches)


def _bench_track(options: argparse.Namespace) -> None:
    from twin_node.bench.track import TrackBenchParameters, run
    from twin_node.nodes.chain_parameters import load_parameters
    from twin_node.nodes.topics import parse_remaps

    parameters = TrackBenchParameters(
        rate=options.rate,
        leave_out=options.leave_out,
        bounce=options.bounce,
        rig=options.rig,
        remaps=parse_remaps(options.remap),
        start_offset_s=options.start_offset or 0.0,
        duration_s=options.duration,
        chain=with_source_options(load_parameters(options.params), options),
    )
    with tqdm(unit="s", disable=None, bar_format="{desc}{n:.1f} s [{elapsed}]") as bar:

        def show(seconds: float) -> None:
            bar.n = seconds
            bar.refresh()

        figures = run(options.log, parameters, show).as_json()
    print_figures(figures, options.json)


def _bench_raster(options: argparse.Namespace) -> None:
    from twin_node.bench import raster

    report = raster.run()
    print(json_text(report) if options.json else raster.table(report))
