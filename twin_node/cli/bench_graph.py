"""`twin_node bench graph`: what the graph costs and survives."""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twin_node.cli.arguments import positive, whole

PARTS = ("latency", "idle", "kills", "recorder", "killed", "network")


def add_bench_graph(benches: Any) -> None:
    """Adds `graph` to the benches."""
    graph = benches.add_parser(
        "graph",
        help="latency over processes, idle load, kills, recorders",
        description="Start the simulated cell's graph on loopback and measure it. Other load on the machine counts.",
    )
    graph.add_argument("--only", choices=PARTS, nargs="+", default=list(PARTS), metavar="PART", help=", ".join(PARTS))
    graph.add_argument("--seconds", type=positive, default=10.0, metavar="S", help="per run (default 10)")
    graph.add_argument("--rounds", type=whole, default=2, metavar="N", help="runs of each kind (default 2)")
    graph.add_argument("--kills", type=whole, default=2, metavar="N", help="kills of each process (default 2)")
    graph.add_argument("--json", action="store_true", help="print one JSON object")
    graph.set_defaults(run=_graph)


def _graph(options: argparse.Namespace) -> None:
    from twin_node.bench import graph, graph_network, graph_recorder

    figures: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="twin_node_") as name:
        folder = Path(name)
        measure: dict[str, Callable[[], Any]] = {
            "latency": lambda: graph.latency(options.seconds, options.rounds, lambda i: str(folder / f"latency_{i}")),
            "idle": lambda: graph.idle(options.seconds),
            "kills": lambda: graph.kills(options.kills),
            "recorder": lambda: graph_recorder.recorded(options.seconds, folder / "recorder"),
            "network": graph_network.network,
            "killed": lambda: graph_recorder.killed(10 * options.kills, folder),
        }
        for part in options.only:
            figures[part] = dataclasses.asdict(measure[part]())
            if not options.json:
                print(f"{part}: " + ", ".join(f"{key} {value}" for key, value in figures[part].items()), flush=True)
    if options.json:
        print(json.dumps(figures))
