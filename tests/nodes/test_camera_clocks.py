"""Cameras whose clocks are off and drift: a log that knows it gives sets on the rig's clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log, write_rig
from twin_node.geometry import pose
from twin_node.messages.convert import camera_info, compressed_image, joint_sample_to_message
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.scene import JointSample, Rig, RigCamera

START, PERIOD = 1_700_000_000_000_000_000, 33_333_333
OFFSET_NS, RATE_PPM = 40_000_000, 80.0


def a_rig() -> Rig:
    K = np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])
    left, right = (pose(np.eye(3), np.array([x, 0, -1])) for x in (0.0, 0.5))
    drifting = ("plumb_bob", np.zeros(5), 0.0, OFFSET_NS, RATE_PPM, START)
    cameras = (RigCamera("steady", 64, 48, K, left), RigCamera("drifting", 64, 48, K, right, *drifting))
    return Rig(cameras, np.array([[-1.0, -1, 0], [1, 1, 1]]))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Twenty pairs of images taken at once, 100 s into the clock's drift."""
    path, rig = tmp_path / "log.mcap", a_rig()
    with LogWriter(path) as writer:
        write_rig(writer, rig, START)
        for i in range(20):
            true = START + 100_000_000_000 + i * PERIOD
            for camera in rig.cameras:
                # The clock's own stamp of a true time: what `rig_time` undoes.
                since = true - START - camera.time_offset_ns
                stamp = START + round(since / (1 + camera.time_rate_ppm * 1e-6)) if camera.time_rate_ppm else true
                writer.write(f"/{camera.name}/camera_info", camera_info(camera, stamp), true)
                image = np.full((48, 64, 3), 10 * i, np.uint8)
                writer.write(f"/{camera.name}/image_raw/compressed", compressed_image(camera.name, stamp, image), true)
    return path


def test_a_drifting_clock_is_corrected_by_offset_and_rate(log: Path) -> None:
    with LogSession(log) as session:
        sets = list(LogSource(session, SynchronizerParameters()))
    assert len(sets) >= 18
    for frames in sets:
        steady, drifting = (view.stamp for view in frames.views)
        assert abs(steady - drifting) <= 20  # the resolution of a float of 100 s in ns
        assert frames.views[0].rgb.mean() == pytest.approx(frames.views[1].rgb.mean(), abs=2)


def test_clocks_of_videos_that_count_from_their_start_are_not_put_on_a_log(log: Path) -> None:
    """As `calibrate rig` writes them: the log's images of that camera were hours off, and all sets without it."""
    steady, drifting = a_rig().cameras
    other = replace(drifting, time_reference_ns=11_000_000_000)
    with LogSession(log, Rig((steady, other))) as session:
        assert [camera.time_offset_ns for camera in session.rig.cameras] == [0, 0]
    with LogSession(log, Rig((steady, drifting))) as session:
        assert [camera.time_offset_ns for camera in session.rig.cameras] == [0, OFFSET_NS]


@pytest.mark.parametrize(
    ("stamps_s", "is_told"), [((0, 0), True), ((102, 102), True), ((100, 100), False), ((0, 100), False)]
)
def test_joints_that_are_stamped_by_another_clock_than_images_are_told(
    log: Path, tmp_path: Path, stamps_s: tuple[int, int], is_told: bool
) -> None:
    """A driver that leaves its stamps 0: the arm in the images was a thing that moves, and nobody said why.

    `stamps_s`: of a message each, seconds after the start; one whose stamp is right is enough, as of an arm's gripper.
    """
    with open_log(log) as read, LogWriter(tmp_path / "joints.mcap") as written:
        for one in read.messages():
            written.write_raw(one.topic, one.msgtype, one.data, one.stamp)
        for stamp_s in stamps_s:
            stamp = START + stamp_s * 1_000_000_000 if stamp_s else 0
            sample = JointSample(stamp, ("elbow",), np.zeros(1), np.zeros(1))
            written.write("/joint_states", joint_sample_to_message(sample), START + 100_000_000_000)
    with LogSession(tmp_path / "joints.mcap") as session:
        assert len(session.set_doubts) == is_told
        assert all("joints on /joint_states are stamped" in line for line in session.set_doubts)
