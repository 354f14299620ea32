"""`twin_node acknowledge`: tells the driver of a live graph's arm that somebody has seen to its halt."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from twin_node.cli.arguments import add_namespace


def add_acknowledge(commands: Any) -> None:
    """Adds `acknowledge` to the subcommands."""
    parser = commands.add_parser(
        "acknowledge",
        help="let an arm go on after a halt, once you have seen to it",
        description="Acknowledge the halt of the arm's driver on the live graph of this machine, as Enter does where "
        "ur-driver runs. Look at the cell first: the arm may move at once. Exit status: 0 the arm is not halted, 1 it "
        "still is.",
    )
    add_namespace(parser, "of the driver in this namespace")
    parser.set_defaults(run=_acknowledge)


def _acknowledge(options: argparse.Namespace) -> int:
    from twin_node.nodes.live.asking import Asking
    from twin_node.runtime.names import ROOT
    from twin_node.runtime.zenoh_session import ZenohParameters

    with Asking(ZenohParameters(namespace=options.namespace or ROOT)) as graph:
        went, words = graph.acknowledge()
    print(words, file=sys.stdout if went else sys.stderr)
    return 0 if went else 1
