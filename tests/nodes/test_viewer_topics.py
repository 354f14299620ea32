"""What RViz and Foxglove are shown of the arm's joints."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twin_logs import START

from twin_node.messages import convert
from twin_node.nodes.live import viewer_topics
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.live.viewer_topics import make_viewer_topics
from twin_node.nodes.topics import JOINT_STATES, OCCUPANCY, OCCUPIED_POINTS, TF, kind_of, kind_of_own
from twin_node.rig import RigFile, save_rig
from twin_node.robot import forward_kinematics, ur_model
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind, NodeIdentity
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import Float64, Grid, JointSample, Occupancy, OccupancyLayer, Rig, RigCamera

ARM, Q = ur_model("ur5e"), np.array([0.1, -1.2, 1.4, -1.8, -1.5, 0.0])


class Viewed:
    """The node on a wire of the test's own, where somebody listens to frames."""

    def __init__(self, folder: Path, *others: Endpoint) -> None:
        """`others`: publishers and subscribers that are in the graph beside it."""
        K = np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])
        save_rig(RigFile(Rig((RigCamera("left", 64, 48, K, np.eye(4)),))), folder / "rig.yaml")
        wire, self._executor = LocalWire(), Executor()
        self.bus = WireBus(wire, self._executor, "viewer_topics", kind_of)
        sections = {"/**": {"rig": {"file": str(folder / "rig.yaml")}}, "arm": {"model": "ur5e"}}
        setup = Setup(
            "viewer_topics", self.bus, SystemClock(), self._executor, sections, "test", lambda: None, lambda: others
        )
        make_viewer_topics(setup).configure()
        self.frames: list[Any] = []
        wire.subscribe("test", TF, kind_of(TF), self.frames.append)
        self.wire = wire
        self._send = wire.publisher("test", JOINT_STATES, kind_of(JOINT_STATES))

    def joints(self, names: Sequence[str], values: Float64) -> None:
        self._send(convert.joint_sample_to_message(JointSample(START, names, values, np.zeros(len(values)))))
        self.step()

    def step(self) -> None:
        while self._executor.step(0.0):
            pass


def test_a_grippers_joints_are_nothing_to_complain_of(tmp_path: Path) -> None:
    """They come on the arm's topic, between its own; the arm's become frames, one per link but the base."""
    viewed = Viewed(tmp_path)
    viewed.joints(("finger_joint",), np.full(1, 0.7))
    viewed.joints(ARM.joint_names, Q)
    traffic = viewed.bus.traffic
    assert [(one.unreadable, one.last_error) for one in traffic] == [(0, None)] * len(traffic)
    (message,) = viewed.frames
    last = message.transforms[-1]
    place = last.transform.translation
    assert last.header.frame_id == "base_link" and last.child_frame_id == ARM.link_names[-1]
    assert np.allclose([place.x, place.y, place.z], forward_kinematics(ARM, Q)[-1, :3, 3])


@pytest.mark.parametrize(
    ("node", "kind", "frames"),
    [
        ("robot_state_publisher", EntityKind.PUBLISHER, 0),
        ("rviz", EntityKind.SUBSCRIBER, 1),
        ("viewer_topics", EntityKind.PUBLISHER, 1),
    ],
)
def test_frames_are_left_to_who_else_publishes_some(tmp_path: Path, node: str, kind: EntityKind, frames: int) -> None:
    """A robot_state_publisher's have other parents: whoever plans by them would find now these, now those."""
    tf = kind_of_own(TF)
    other = Endpoint(kind, NodeIdentity("1", 0, node), 1, TF, tf.msgtype or "", "", tf.qos)
    viewed = Viewed(tmp_path, other)
    viewed.joints(ARM.joint_names, Q)
    assert len(viewed.frames) == frames


def test_occupied_space_is_asked_for_once_somebody_looks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A twin whose occupancy nobody hears does not send it."""
    monkeypatch.setattr(viewer_topics, "LOOK_NS", 1_000_000)
    viewed = Viewed(tmp_path)
    send = viewed.wire.publisher("twin", OCCUPANCY, kind_of(OCCUPANCY))

    def see() -> None:
        time.sleep(0.002)
        send(convert.occupancy_to_message(OCCUPIED))
        viewed.step()

    see()
    assert not viewed.wire.is_heard("twin", OCCUPANCY, kind_of_own(OCCUPANCY))
    points: list[Any] = []
    viewed.wire.subscribe("rviz", OCCUPIED_POINTS, kind_of(OCCUPIED_POINTS), points.append)
    see()
    see()
    assert [message.width for message in points] == [2]


OCCUPIED = Occupancy(
    *(START, START, Grid(np.zeros(3), 0.1, (2, 2, 2))),
    (OccupancyLayer(0, np.array([1, 6], np.uint32), np.array([255, 128], np.uint8)),),
    *(OccupancyLayer(0, np.zeros(0, np.uint32), np.zeros(0, np.uint8)), np.zeros((0, 2), np.uint32)),
)
