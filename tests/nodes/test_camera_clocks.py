"""Cameras whose clocks are off and drift: a log that knows it gives sets on the rig's clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log, write_rig
from twin_node.errors import TwinWarning
from twin_node.geometry import pose
from twin_node.messages import header_stamp, to_time
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


def test_a_clock_that_counts_from_its_start_is_that_of_stamps_which_do_whenever_they_were_recorded(
    log: Path, tmp_path: Path
) -> None:
    """What `calibrate time` had found of a camera that stamps by when it was switched on was left out again."""
    steady, drifting = a_rig().cameras
    path = tmp_path / "since_on.mcap"
    with open_log(log) as read, LogWriter(path) as written:
        for one in read.messages():
            message = one.message
            if one.topic.startswith("/drifting/"):
                since_on = to_time(header_stamp(message) - START)
                message = replace(message, header=replace(message.header, stamp=since_on))
            written.write(one.topic, message, one.stamp)
    timed = replace(drifting, time_offset_ns=START + OFFSET_NS, time_reference_ns=1_000_000_000)
    with LogSession(path, Rig((steady, timed))) as session:
        assert session.rig.cameras[1].time_offset_ns == START + OFFSET_NS
        assert all(len(frames.views) == 2 for frames in LogSource(session, SynchronizerParameters()))


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


def write_apart(
    path: Path, off_s: dict[str, float], recorded: str = "when taken", late_s: float = 0.0, unstamped: str = ""
) -> None:
    """Two seconds of three cameras, each with a clock of its own; `late_s`: when the camera "c" begins.

    `recorded`: at which times of the log; `unstamped`: cameras whose stamps are 0.
    """
    K = np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])
    poses = [pose(np.eye(3), np.array([x, 0, -1])) for x in (0.0, 0.5, 1.0)]
    rig = Rig(tuple(RigCamera(name, 64, 48, K, T) for name, T in zip("abc", poses, strict=True)), None)
    image = np.zeros((48, 64, 3), np.uint8)
    with LogWriter(path) as writer:
        write_rig(writer, rig, START)
        for camera in rig.cameras:
            writer.write(f"/{camera.name}/camera_info", camera_info(camera, START), START)
        for i in range(10):
            true = START + i * 200_000_000
            stored = {"when taken": true, "at once": START, "an hour early": true - 3_600_000_000_000}[recorded]
            for name in "abc"[: 3 if true >= START + late_s * 1e9 else 2]:
                stamp = 0 if name in unstamped else true + round(off_s.get(name, 0.0) * 1e9)
                writer.write(f"/{name}/image_raw/compressed", compressed_image(name, stamp, image), stored)


@pytest.mark.filterwarnings("ignore:no set of images in the last 3598:twin_node.errors.TwinWarning")
@pytest.mark.parametrize("recorded", ["when taken", "an hour early"])
@pytest.mark.parametrize(
    ("off_s", "told"),
    [
        ({"c": 3600.0}, {"c": 3600.0}),
        ({"a": 0.4}, {"a": 0.4}),
        ({"a": 0.4, "b": 0.4}, {}),
        ({"a": 0.4, "b": 5.0}, {"a": 0.4, "b": 5.0}),
        ({"b": -5.0}, {"b": -5.0}),
    ],
)
def test_a_camera_by_another_clock_is_told_and_takes_no_set_from_the_others(
    tmp_path: Path, off_s: dict[str, float], told: dict[str, float], recorded: str
) -> None:
    """One that was ahead had all sets for itself, for the others' images were late by it; a live twin refuses it.

    Two that agree are the cell's clock.
    """
    write_apart(tmp_path / "log.mcap", off_s, recorded)
    with LogSession(tmp_path / "log.mcap") as session:
        assert session.clocks.apart == {name: round(s * 1e9) for name, s in told.items()}
        starts = [f"camera '{name}': images are stamped {abs(s):.3f} s" for name, s in told.items()]
        lines = [line for line in session.camera_doubts if "by another clock" in line]
        assert [line.startswith(start) for start, line in zip(starts, lines, strict=True)] == [True] * len(told)
        with pytest.warns(TwinWarning):
            sets = list(LogSource(session, SynchronizerParameters()))
        with pytest.warns(TwinWarning):
            every = list(LogSource(session, SynchronizerParameters(), takes_all=True))
        rig = session.rig
    if told:
        assert [len(frames.views) for frames in every][1:-1] == [3] * 8
        assert max(np.ptp([view.stamp for view in frames.views]) for frames in every) == 0
    theirs = set("abc") - (set(told) or {"c"})
    assert len(sets) >= 8
    assert all({view.camera.name for view in frames.views} == theirs for frames in sets[1:-1])
    offsets = {camera.name: round(-off_s.get(camera.name, 0.0) * 1e9) for camera in rig.cameras}
    mended = tuple(replace(camera, time_offset_ns=offsets[camera.name]) for camera in rig.cameras)
    with LogSession(tmp_path / "log.mcap", Rig(mended, None)) as session:
        assert session.clocks.apart == {}
        assert [len(frames.views) for frames in LogSource(session, SynchronizerParameters())][1:-1] == [3] * 8


@pytest.mark.parametrize(("recorded", "late_s"), [("at once", 0.0), ("at once", 0.6), ("when taken", 0.6)])
def test_cameras_by_one_clock_are_not_told_whenever_they_come_and_are_recorded(
    tmp_path: Path, recorded: str, late_s: float
) -> None:
    write_apart(tmp_path / "log.mcap", {}, recorded, late_s)
    with LogSession(tmp_path / "log.mcap") as session:
        assert session.clocks.apart == {}
        sets = list(LogSource(session, SynchronizerParameters()))
    assert len(sets) >= 8 and len(sets[-2].views) == 3


@pytest.mark.parametrize("unstamped", ["b", "abc"])
def test_cameras_without_stamps_are_told(tmp_path: Path, unstamped: str) -> None:
    """Of a driver that leaves them out, images were said to lie too far from the others', or to be a simulator's."""
    write_apart(tmp_path / "log.mcap", {}, unstamped=unstamped)
    with LogSession(tmp_path / "log.mcap") as session:
        assert session.clocks.apart == {}
        lines = [line for line in session.doubts if "header.stamp is 0" in line]
        assert [line.split("'")[1] for line in lines] == list(unstamped)
        assert not any("another clock" in line for line in session.doubts)
        assert [name for name in "abc" if name not in session.cameras_in_sets] == list(unstamped)
