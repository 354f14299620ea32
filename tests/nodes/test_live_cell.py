"""The simulated cell as a live source: sets of all cameras and the arm by the wall clock, until its time is over."""

from __future__ import annotations

import threading
import time
from typing import Any

from twin_node.messages import header_stamp
from twin_node.nodes.live.cell import CellNode, CellParameters
from twin_node.nodes.live.rig_source import RigParameters, topics_of
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import JOINT_STATES, TF_STATIC, TRAJECTORY, kind_of
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus

RIG = RigParameters(scenario="demo", image="image_raw", depth="depth/image_rect")


def test_a_cell_sends_what_a_rig_would() -> None:
    wire, executor, finished = LocalWire(), Executor(), threading.Event()
    heard: dict[str, list[Any]] = {}
    cameras = [topics_of(name, RIG) for name in ("cam_back", "cam_front", "cam_left")]
    wanted = [*(t for c in cameras for t in (c.image, c.depth, c.info) if t), JOINT_STATES, TRAJECTORY, TF_STATIC]
    for topic in wanted:
        wire.subscribe("test", topic, kind_of(topic), heard.setdefault(topic, []).append)
    bus = WireBus(wire, executor, "cell", kind_of)
    setup = Setup("cell", bus, SystemClock(), executor, {}, "test", finished.set, wire.endpoints)
    node = CellNode(setup, CellParameters(rig=RIG, duration=1.0))
    begun = time.time_ns()
    node.configure()
    node.activate()
    while not finished.is_set():
        executor.step(0.05)
    node.deactivate()
    node.cleanup()
    for camera in cameras:
        stamps = [header_stamp(message) for message in heard[camera.image]]
        assert stamps
        assert begun <= stamps[0] <= stamps[-1] <= time.time_ns()
        assert stamps == sorted(set(stamps))
        assert stamps == [header_stamp(message) for message in heard[str(camera.depth)]]
    joints = [header_stamp(message) for message in heard[JOINT_STATES]]
    assert joints == sorted(joints)
    assert len(joints) > len(heard[TRAJECTORY]) > 0
    assert len(heard[TF_STATIC]) == 1
