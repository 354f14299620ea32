"""The viewer's page as a node of a live graph."""

from __future__ import annotations

from twin_node.nodes.live.rig_source import read_rig
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.viewer import CellPage, ViewerNode, ViewerParameters
from twin_node.rig import FrameAssembler
from twin_node.runtime.node import Node


def make_viewer(setup: Setup) -> Node:
    """A page of the graph that the launch file describes; says where it is.

    Raises `ViewerError` where viser is not installed or the port is taken.
    """
    parameters = setup.parameters(ViewerParameters)
    source = read_rig(setup.rig())
    assembler = FrameAssembler(source.rig.cameras, parameters.width)
    arm = setup.chain_parameters().arm.arm()
    page = CellPage(arm, assembler.cameras, parameters.host, parameters.port)
    print(f"viewer: {page.url}", flush=True)
    return ViewerNode(setup.bus, setup.clock, page, source.cameras, assembler)
