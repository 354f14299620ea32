"""A log played onto a bus at its own pace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log
from twin_node.messages import convert, header, message_type
from twin_node.nodes.player import Player, span_of
from twin_node.nodes.topics import JOINT_STATES, GraphError
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import PacedClock, SteppedClock

HOUR_NS = 3_600_000_000_000


def test_who_is_impatient_is_told_the_time_while_a_log_has_nothing_to_say(tmp_path: Path) -> None:
    """Whoever plays a log beside other duties, as the driver of an arm does, sees to them in its gaps."""
    said, spoken = message_type("std_msgs/msg/String"), []
    with LogWriter(tmp_path / "log.mcap") as writer:
        for stamp in (0, HOUR_NS):
            writer.write("/chatter", said(data=str(stamp)), stamp)
    bus, clock = LocalBus(), PacedClock(0, 1.0)
    bus.subscribe("/chatter", lambda message: spoken.append(message.data))
    with open_log(tmp_path / "log.mcap") as log:
        clock.start()
        steps = Player(log, bus, {"/chatter": "/chatter"}, span_of(log)).steps(clock, patience_s=0.001)
        times = [next(steps) for _ in range(5)]
    assert spoken == ["0"]
    assert times[0] == 0
    assert 0 < times[1] < times[2] < times[3] < times[4] < HOUR_NS


def test_a_damaged_message_is_told_with_its_place(tmp_path: Path) -> None:
    said, heard = message_type("std_msgs/msg/String"), []
    with LogWriter(tmp_path / "log.mcap") as writer:
        writer.write("/chatter", said(data="0"), HOUR_NS)
        writer.write_raw("/chatter", "std_msgs/msg/String", b"\0\1\0\0\xff\xff", HOUR_NS + 1_250_000_000)
    bus = LocalBus()
    bus.subscribe("/chatter", lambda message: heard.append(message.data))
    words = r"log\.mcap: /chatter, 1\.250 s after the log's start: std_msgs/msg/String: 6 bytes are not a CDR .*check"
    with open_log(tmp_path / "log.mcap") as log, pytest.raises(GraphError, match=words):
        list(Player(log, bus, {"/chatter": "/chatter"}, span_of(log)).steps(SteppedClock()))
    assert heard == ["0"]


def test_joints_that_nobody_can_use_are_told_with_their_place(tmp_path: Path) -> None:
    joint, bus = message_type("sensor_msgs/msg/JointState"), LocalBus()
    bus.subscribe(JOINT_STATES, convert.joint_sample_from_message)
    none = np.zeros(0)
    unequal = joint(header=header(0, ""), name=["elbow"], position=np.zeros(2), velocity=none, effort=none)
    with LogWriter(tmp_path / "log.mcap") as writer:
        nothing = joint(header=header(0, ""), name=[], position=none, velocity=none, effort=none)
        writer.write("/ur/joint_states", nothing, HOUR_NS)
        writer.write("/ur/joint_states", unequal, HOUR_NS + 1_250_000_000)
    words = r"log\.mcap: /ur/joint_states, 1\.250 s after the log's start: JointState at 0 ns: 1 names, 2 positions"
    with open_log(tmp_path / "log.mcap") as log, pytest.raises(GraphError, match=words):
        list(Player(log, bus, {"/ur/joint_states": JOINT_STATES}, span_of(log)).steps(SteppedClock()))
