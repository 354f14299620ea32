"""`twin_node sim`: a simulated cell, written as a log or live."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import add_params_file, file_or_name, given_of, positive, refuse_given, seed, width
from twin_node.cli.progress import counted
from twin_node.errors import TwinError


def add_sim(commands: Any) -> None:
    """Adds `sim` to the subcommands."""
    sim = commands.add_parser(
        "sim",
        help="simulate a cell: write it as a log, or run it live",
        description="With -o the scenario becomes a log with images, depth, calibration, the arm's joints and the true "
        "occupancy. Without, it runs live: as 'twin_node launch launch/sim_cell.yaml scenario:=SCENARIO'. "
        "sim/README.md documents scenarios.",
    )
    sim.add_argument("scenario", type=file_or_name, nargs="?", metavar="SCENARIO", help="file, or name below sim/")
    sim.add_argument("-o", "--output", type=Path, metavar="LOG.mcap", help="write a log")
    sim.add_argument("--list", action="store_true", help="list the scenarios that come with the package and end")
    sim.add_argument("--seed", type=seed, metavar="N", help="other noise, and other motion where it varies")
    sim.add_argument("--duration", type=positive, metavar="S", help="simulate so many seconds")
    sim.add_argument("--width", type=width, metavar="PX", help="width of the images; their shape stays")
    add_params_file(sim)
    sim.set_defaults(run=_sim)


def _sim(options: argparse.Namespace) -> int | None:
    if options.list:
        _list()
        return None
    if options.scenario is None:
        raise TwinError("sim: expected a scenario, found none; 'twin_node sim --list' names those that there are")
    if options.output is None:
        return _live(options)
    refuse_given(options, ("params_file",), "expected in a live run, without -o; leave one of them out")
    _write(options)
    return None


def _list() -> None:
    from twin_node import resources
    from twin_node.cell import load_scenario

    for path in sorted(resources.find("sim/demo.yaml").parent.glob("*.yaml")):
        scenario = load_scenario(path)
        about = path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
        print(f"{path.stem:<14} {scenario.duration_s:4.0f} s  {about}")


def _write(options: argparse.Namespace) -> None:
    from twin_node.cell import Scenario, load_scenario, write_log

    scenario: Scenario = load_scenario(options.scenario)
    if options.seed is not None:
        scenario = scenario.with_seed(options.seed)
    if options.duration is not None:
        scenario = replace(scenario, duration_s=options.duration)
    if options.width is not None:
        scenario = scenario.at_width(options.width)
    with counted("simulate", "message") as show:
        write_log(scenario, options.output, show)
    print(f"{options.output}: {scenario.name}, seed {scenario.seed}, {scenario.duration_s:g} s")


def _live(options: argparse.Namespace) -> int | None:
    """Starts the launch file of the simulated cell; what only a log can be given is refused."""
    from twin_node.cell import load_scenario
    from twin_node.cli.launch import launch

    for flag in given_of(options, ("seed", "width")):
        raise TwinError(f"sim: {flag} is for logs; give -o LOG.mcap too, or set it in a scenario file of your own")
    load_scenario(options.scenario)
    arguments = [f"scenario:={options.scenario}"]
    if options.duration is not None:
        arguments.append(f"duration:={options.duration}")
    return launch(Path("launch/sim_cell.yaml"), arguments, options.params_file)
