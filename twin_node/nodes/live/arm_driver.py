"""The UR driver as a node of a live graph."""

from __future__ import annotations

from twin_node.arm.ur import UrParameters
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.ur_driver import TICK_S, UrDriverNode
from twin_node.runtime.node import Node


def make_ur_driver(setup: Setup) -> Node:
    """The driver of the arm that its parameters name."""
    node = UrDriverNode(setup.bus, setup.clock, setup.parameters(UrParameters), setup.say)
    setup.timers.every(TICK_S, node.tick)
    return node
