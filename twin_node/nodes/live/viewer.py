"""The viewer's page as a node of a live graph."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from twin_node.nodes.live.graph_cameras import GraphCameras
from twin_node.nodes.live.rig_source import read_rig
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.viewer import CellPage, LiveCameras, ViewerNode, ViewerParameters
from twin_node.rig import FrameAssembler, load_rig
from twin_node.runtime.node import Node


def make_viewer(setup: Setup) -> Node:
    """A page of the graph, which says where it is; of the launch file's cameras, else those that the graph tells of."""
    parameters = setup.parameters(ViewerParameters)
    arm = setup.chain_parameters().arm.arm()

    def open_page() -> CellPage:
        page = CellPage(arm, (), parameters.host, parameters.port)
        setup.say(page.url)
        return page

    return ViewerNode(setup.bus, setup.clock, setup.timers, open_page, _camera_finder(setup, parameters))


def _camera_finder(setup: Setup, parameters: ViewerParameters) -> Callable[[], LiveCameras | None]:
    given = setup.rig()
    if not (given.log or given.file or given.scenario):
        rig = load_rig(parameters.rig_file).rig if parameters.rig_file else None
        return GraphCameras(setup, parameters.width, rig)
    source = read_rig(given)
    known = iter([LiveCameras(source.cameras, FrameAssembler(source.rig.cameras, parameters.width))])
    return partial(next, known, None)
