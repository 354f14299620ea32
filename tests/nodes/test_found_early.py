"""What others find of a graph before anything has been seen: topics and their types, as of any ROS 2 node."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twin_node.nodes.live.setup import Setup
from twin_node.nodes.live.twin import make_twin
from twin_node.nodes.live.viewer_topics import make_viewer_topics
from twin_node.nodes.topics import (
    GAUSSIANS,
    GAUSSIANS_MOVING,
    OBSTACLE_MARKERS,
    OBSTACLES,
    OCCUPANCY,
    OCCUPIED_POINTS,
    STATUS,
    kind_of,
)
from twin_node.rig import RigFile, save_rig
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.node import Node
from twin_node.runtime.qos import TopicKind
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import Rig, RigCamera


class Listed(LocalWire):
    """A wire that lists what is said to be published on it."""

    def __init__(self) -> None:
        super().__init__()
        self.types: dict[str, str | None] = {}

    def advertise(self, node: str, topic: str, kind: TopicKind) -> None:
        self.types[topic] = kind.msgtype


@pytest.mark.parametrize(
    ("make", "topics"),
    [
        (make_twin, (GAUSSIANS, GAUSSIANS_MOVING, OBSTACLES, OCCUPANCY, STATUS)),
        (make_viewer_topics, (OBSTACLE_MARKERS, OCCUPIED_POINTS)),
    ],
)
def test_topics_are_found_before_the_first_image(
    tmp_path: Path, make: Callable[[Setup], Node], topics: tuple[str, ...]
) -> None:
    """RViz could not be told of them, and `doctor` said that nobody publishes them, though a twin was there."""
    K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
    workspace = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
    save_rig(RigFile(Rig((RigCamera("front", 16, 12, K, np.eye(4)),), workspace)), tmp_path / "rig.yaml")
    wire, executor = Listed(), Executor()
    bus = WireBus(wire, executor, "node", kind_of)
    sections = {"/**": {"rig": {"file": str(tmp_path / "rig.yaml")}}}
    make(Setup("node", bus, SystemClock(), executor, sections, "test", executor.stop, tuple)).configure()
    assert {topic: wire.types.get(topic) for topic in topics} == {topic: kind_of(topic).msgtype for topic in topics}
