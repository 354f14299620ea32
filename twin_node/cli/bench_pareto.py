"""`twin_node bench pareto | ablations | costs | length`: speed against accuracy, and what costs what."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import not_negative, positive, refuse_given, whole, width, with_given
from twin_node.cli.output import add_json
from twin_node.cli.progress import over
from twin_node.json_text import json_text


def add_bench_pareto(benches: Any) -> None:
    """Adds `bench pareto`."""
    pareto = benches.add_parser("pareto", help="speed against accuracy: all methods, ours at five sizes")
    pareto.add_argument(
        "logs", nargs="*", type=Path, metavar="LOG", help="recordings to measure beside the made-up scene"
    )
    pareto.add_argument("--quick", action="store_true", help="small and short: shows that all run")
    pareto.add_argument("--start-offset", type=not_negative, metavar="S", help="skip the first S seconds of each log")
    pareto.add_argument("--params", type=Path, metavar="FILE.yaml", help="ROS parameter file of the chain")
    pareto.add_argument("--frames", type=whole, metavar="N", help="take at most N sets of each log")
    pareto.add_argument("--methods", metavar="A,B", help="only these beside ours; a wrong name lists them all")
    pareto.add_argument("--processes", type=whole, metavar="N", help="methods at once (default 1; with --quick 2)")
    pareto.add_argument(
        "--out", type=Path, metavar="DIR", help="write pareto.json, .md, .png, .svg and sizes.yaml here"
    )
    pareto.add_argument("--check", action="store_true", help="end with status 2 where an online method dominates ours")
    add_json(pareto)
    pareto.set_defaults(run=_bench_pareto)


def _bench_pareto(options: argparse.Namespace) -> None:
    from twin_node.bench.pareto.chart import draw
    from twin_node.bench.pareto.suite import QUICK, ParetoParameters, run
    from twin_node.bench.pareto.tables import front_text, markdown, text
    from twin_node.bench.results_folder import prepared, save_figures, save_text
    from twin_node.nodes.chain_parameters import load_parameters

    if not options.logs:
        refuse_given(options, ("frames", "start_offset"), "expected with a LOG, which they are of; give one")
    parameters = with_given(
        QUICK if options.quick else ParetoParameters(),
        logs=tuple(options.logs),
        chain=load_parameters(options.params),
        frames=options.frames,
        processes=options.processes,
        rivals=_names(options.methods),
        start_offset_s=options.start_offset,
    )
    if options.out is not None:
        prepared(options.out)
    found = run(parameters, over("method"))
    figures = found.as_json()
    print(json_text(figures) if options.json else text(found))
    if options.out is not None:
        save_figures(options.out, "pareto", figures, markdown(found))
        save_text(options.out, "sizes.yaml", front_text(found.points))
        draw(found, options.out)
    if options.check:
        found.check()


def _names(text: str | None) -> tuple[str, ...] | None:
    """Of a list that was given, each once."""
    return None if text is None else tuple(dict.fromkeys(text.split(",")))


def add_bench_ablations(benches: Any) -> None:
    """Adds `bench ablations`."""
    ablations = benches.add_parser("ablations", help="what each part of the twin is worth, on logs")
    ablations.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="recordings to measure on")
    ablations.add_argument(
        "--frames", type=whole, default=150, metavar="N", help="take at most N sets of each log (default 150)"
    )
    ablations.add_argument(
        "--start-offset", type=not_negative, default=0.0, metavar="S", help="skip the first S seconds of each log"
    )
    ablations.add_argument("--only", metavar="A,B", help="only these; a wrong name lists them all")
    ablations.add_argument("--params", type=Path, metavar="FILE.yaml", help="ROS parameter file of the chain")
    ablations.add_argument("--width", type=width, default=160, metavar="PX", help="working width (default 160)")
    ablations.add_argument("--processes", type=whole, default=1, metavar="N", help="runs at once (default 1)")
    ablations.add_argument("--out", type=Path, metavar="DIR", help="write ablations.json and .md here")
    add_json(ablations)
    ablations.set_defaults(run=_bench_ablations)


def add_bench_costs(benches: Any) -> None:
    """Adds `bench costs`."""
    costs = benches.add_parser("costs", help="what a set costs by what moves and by the scene's size")
    costs.add_argument("--processes", type=whole, default=1, metavar="N", help="runs at once (default 1)")
    add_json(costs)
    costs.set_defaults(run=_bench_costs)


def add_bench_length(benches: Any) -> None:
    """Adds `bench length`."""
    length = benches.add_parser("length", help="what a set costs, and what memory holds, while a run lasts an hour")
    length.add_argument(
        "--seconds", type=positive, default=3600.0, metavar="S", help="length of the run by its stamps (default 3600)"
    )
    length.add_argument("--rate", type=positive, default=10.0, metavar="HZ", help="sets per second (default 10)")
    length.add_argument("--size", default="tiny", metavar="SIZE", help="size of the model (default tiny)")
    length.add_argument("--out", type=Path, metavar="DIR", help="write length.json, .md, .png and .svg here")
    add_json(length)
    length.set_defaults(run=_bench_length)


def _bench_length(options: argparse.Namespace) -> None:
    from twin_node.bench.pareto import length
    from twin_node.bench.results_folder import prepared, save_figures

    if options.out is not None:
        prepared(options.out)
    parameters = length.LengthParameters(options.seconds, options.rate, options.size)
    found = length.run(parameters, over("min"))
    print(json_text(found.as_json()) if options.json else length.text(found))
    if options.out is not None:
        save_figures(options.out, "length", found.as_json(), length.markdown(found))
        length.draw(found, options.out)


def _bench_ablations(options: argparse.Namespace) -> None:
    from twin_node.bench.pareto import ablations
    from twin_node.bench.results_folder import prepared, save_figures

    parameters = ablations.AblationParameters(
        tuple(options.logs),
        options.frames,
        options.start_offset,
        params=options.params,
        width=options.width,
        processes=options.processes,
    )
    parameters = with_given(parameters, names=_names(options.only))
    if options.out is not None:
        prepared(options.out)
    rows = ablations.run(parameters, over("run"))
    print(json_text(ablations.as_json(rows)) if options.json else ablations.text(rows))
    if options.out is not None:
        save_figures(options.out, "ablations", ablations.as_json(rows), ablations.markdown(rows))


def _bench_costs(options: argparse.Namespace) -> None:
    from twin_node.bench.pareto import costs

    parameters = costs.CostParameters(processes=options.processes)
    found = costs.run(parameters, over("run"))
    print(json_text(costs.as_json(found)) if options.json else costs.text(found))
