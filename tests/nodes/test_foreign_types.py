"""Logs in which a name of ours is that of something else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from twin_node.bag import LogWriter, open_log
from twin_node.messages import message_type
from twin_node.nodes.log_check import check_log
from twin_node.nodes.log_source import LogSession
from twin_node.nodes.playback import Playback
from twin_node.nodes.topics import GraphError


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        ("/joint_states", "sensor_msgs/msg/JointState"),
        ("/arm/trajectory", "trajectory_msgs/msg/JointTrajectory"),
        ("/tf_static", "tf2_msgs/msg/TFMessage"),
        ("/cam_back/camera_info", "sensor_msgs/msg/CameraInfo"),
    ],
)
def test_a_topic_of_another_type_than_its_name_has_here_is_refused(
    cell_log: Callable[..., Path], tmp_path: Path, topic: str, kind: str
) -> None:
    """A trajectory of a planner's on /arm/trajectory, or a remap of the wrong topic: it ended in a traceback."""
    path = tmp_path / "log.mcap"
    with open_log(cell_log(0.3)) as read, LogWriter(path) as log:
        for one in read.messages():
            if one.topic != topic:
                log.write_raw(one.topic, one.msgtype, one.data, one.stamp)
        text = message_type("std_msgs/msg/String")(data="planned")
        log.write(topic, text, read.start_ns)
        log.write("/others", text, read.start_ns)
    expected = f"expected {kind} on {topic}, found std_msgs/msg/String; give it another name: --remap {topic}:=/OTHER"
    with pytest.raises(GraphError, match=expected):
        LogSession(path)
    with pytest.raises(GraphError, match=expected):
        Playback([path])
    with open_log(path) as log:
        (fault,) = check_log(log).faults
    assert expected in fault
    with pytest.raises(GraphError, match=f"expected {kind} on {topic}, found .*String on /others"):
        LogSession(path, remaps={topic: "/elsewhere", "/others": topic})
