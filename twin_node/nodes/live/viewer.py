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
    """A page of the graph; says where it is. Its cameras are those of the launch file's rig, else what the graph says.

    Raises `ViewerError` where viser is not installed or the port is taken.
    """
    parameters = setup.parameters(ViewerParameters)
    find = _camera_finder(setup, parameters)
    page = CellPage(setup.chain_parameters().arm.arm(), (), parameters.host, parameters.port)
    setup.say(page.url)
    return ViewerNode(setup.bus, setup.clock, setup.timers, page, find)


def _camera_finder(setup: Setup, parameters: ViewerParameters) -> Callable[[], LiveCameras | None]:
    given = setup.rig()
    if not (given.log or given.file or given.scenario):
        rig = load_rig(parameters.rig_file).rig if parameters.rig_file else None
        return GraphCameras(setup, parameters.width, rig)
    source = read_rig(given)
    known = iter([LiveCameras(source.cameras, FrameAssembler(source.rig.cameras, parameters.width))])
    return partial(next, known, None)
