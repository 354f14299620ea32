"""The OAK cameras of a launch file on depthai's host nodes; made in the launch's own process, by entry point."""

from __future__ import annotations

from host_oak import HostStreams

from twin_node.nodes.live.cameras import CamerasNode, CamerasParameters
from twin_node.nodes.live.setup import Setup
from twin_node.rig.cameras.oak import OakSource
from twin_node.runtime.node import Node


def make_cameras(setup: Setup) -> Node:
    """As `twin_node.nodes.live.cameras.make_cameras`, without devices."""
    parameters = setup.parameters(CamerasParameters)
    return CamerasNode(setup, OakSource(parameters.oak, HostStreams), parameters.rig)
