"""`twin_node bench graph`: what the graph costs and survives."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import file_or_name, positive, whole
from twin_node.cli.output import add_json
from twin_node.json_text import json_text

PARTS = ("latency", "hops", "idle", "kills", "recorder", "killed", "network", "cameras", "live")

KILLED_RECORDERS = 20
CAMERA_FAULT_S = 4.0
"""How long each camera fault lasts, s: diagnostics tell of it in the second second at the latest."""


def add_bench_graph(benches: Any) -> None:
    """Adds `graph` to the benches."""
    graph = benches.add_parser(
        "graph",
        help="latency over processes, idle load, kills, recorders, a link that is cut, cameras that fail, an arm "
        "beside people",
        description="Start the simulated cell's graph on loopback and measure it, in about 17 minutes. Other load on "
        "the machine counts. `network` needs root, or `unshare --map-root-user`. Exit status: 1 where a part failed.",
    )
    graph.add_argument(
        "--only",
        choices=PARTS,
        nargs="+",
        default=list(PARTS),
        metavar="PART",
        help=f"only these of {', '.join(PARTS)}",
    )
    graph.add_argument("--seconds", type=positive, default=20.0, metavar="S", help="length of a run (default 20)")
    graph.add_argument(
        "--record-seconds", type=positive, default=300.0, metavar="S", help="how long a recorder runs (default 300)"
    )
    graph.add_argument(
        "--live-seconds", type=positive, default=90.0, metavar="S", help="how long the arm is watched (default 90)"
    )
    graph.add_argument(
        "--scenario",
        type=file_or_name,
        default="demo",
        metavar="SCENARIO",
        help="what `live` launches, a scenario of sim/ (default demo)",
    )
    graph.add_argument(
        "--size", default="auto", metavar="SIZE", help="of the model that `live` launches (default auto: it finds out)"
    )
    graph.add_argument("--rounds", type=whole, default=2, metavar="N", help="runs of each kind (default 2)")
    graph.add_argument("--kills", type=whole, default=5, metavar="N", help="kills of each process (default 5)")
    graph.add_argument("--cuts", type=whole, default=3, metavar="N", help="cuts of the link (default 3)")
    add_json(graph)
    graph.set_defaults(run=_graph)


def _graph(options: argparse.Namespace) -> int:
    from twin_node.bench import graph, graph_cameras, graph_hops, graph_live, graph_network, graph_recorder
    from twin_node.bench.graph_table import table
    from twin_node.cell import load_scenario
    from twin_node.errors import TwinError

    load_scenario(options.scenario)  # what is wrong is told before anything is measured
    graph_live.check_size(options.size)
    figures: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="twin_node_") as name:
        folder = Path(name)
        measure: dict[str, Callable[[], Any]] = {
            "latency": lambda: graph.latency(options.seconds, options.rounds, folder),
            "hops": lambda: graph_hops.hops(options.seconds),
            "idle": lambda: graph.idle(options.seconds),
            "kills": lambda: graph.kills(options.kills),
            "recorder": lambda: graph_recorder.recorded(options.record_seconds, folder / "recorder"),
            "killed": lambda: graph_recorder.killed(KILLED_RECORDERS, folder),
            "network": lambda: graph_network.network(cuts=options.cuts),
            "cameras": lambda: graph_cameras.cameras(CAMERA_FAULT_S),
            "live": lambda: graph_live.live(options.live_seconds, options.scenario, options.size),
        }
        for part in dict.fromkeys(options.only):
            try:
                found = measure[part]()
                figures[part], lines = dataclasses.asdict(found), table(part, found)
            except TwinError as error:  # the other parts can be measured nevertheless
                figures[part], lines = {"error": str(error)}, f"{part}: {error}"
            print(lines, file=sys.stderr if options.json else sys.stdout, flush=True)
    if options.json:
        print(json_text(figures))
    return 1 if any("error" in found for found in figures.values()) else 0
