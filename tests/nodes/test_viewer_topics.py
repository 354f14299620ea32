"""What RViz and Foxglove are shown of the arm's joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from twin_logs import START

from twin_node.messages import convert
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.live.viewer_topics import make_viewer_topics
from twin_node.nodes.topics import JOINT_STATES, TF, kind_of
from twin_node.rig import RigFile, save_rig
from twin_node.robot import forward_kinematics, ur_model
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import JointSample, Rig, RigCamera


def test_a_grippers_joints_are_nothing_to_complain_of(tmp_path: Path) -> None:
    """They come on the arm's topic, between its own; the arm's become frames, one per link but the base."""
    K = np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])
    save_rig(RigFile(Rig((RigCamera("left", 64, 48, K, np.eye(4)),))), tmp_path / "rig.yaml")
    wire, executor = LocalWire(), Executor()
    bus = WireBus(wire, executor, "viewer_topics", kind_of)
    sections = {"/**": {"rig": {"file": str(tmp_path / "rig.yaml")}}, "arm": {"model": "ur5e"}}
    setup = Setup("viewer_topics", bus, SystemClock(), executor, sections, "test", lambda: None, lambda: ())
    make_viewer_topics(setup).configure()
    frames: list[object] = []
    wire.subscribe("test", TF, kind_of(TF), frames.append)
    arm, q = ur_model("ur5e"), np.array([0.1, -1.2, 1.4, -1.8, -1.5, 0.0])
    send = wire.publisher("test", JOINT_STATES, kind_of(JOINT_STATES))
    for names, values in ((("finger_joint",), np.full(1, 0.7)), (arm.joint_names, q)):
        send(convert.joint_sample_to_message(JointSample(START, names, values, np.zeros(len(values)))))
        while executor.step(0.0):
            pass
    assert [(traffic.unreadable, traffic.last_error) for traffic in bus.traffic] == [(0, None)] * len(bus.traffic)
    (message,) = frames
    last = message.transforms[-1]
    place = last.transform.translation
    assert last.header.frame_id == "base_link" and last.child_frame_id == arm.link_names[-1]
    assert np.allclose([place.x, place.y, place.z], forward_kinematics(arm, q)[-1, :3, 3])
