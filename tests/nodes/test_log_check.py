"""What `check` finds in a log, and what it must not: faults of values, and of cameras whose clocks are known."""

from __future__ import annotations

import contextlib
import re
import tracemalloc
from array import array
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from twin_logs import write_twin_log

from twin_node.bag import LogMessage, LogWriter, open_log
from twin_node.bag.rig import write_rig
from twin_node.cli import main
from twin_node.messages import Message, convert, message_type
from twin_node.nodes.clock_steps import clock_step
from twin_node.nodes.log_check import LogCheck, check_log
from twin_node.nodes.log_source import LogSession
from twin_node.scene import JointPath, JointSample, Rig, RigCamera

MS = 1_000_000
START = 1_700_000_000_000 * MS
PERIOD = 33 * MS
BOX = np.array([[-1.0, -1, 0], [1, 1, 1]])
LEFT = RigCamera("left", 32, 24, np.array([[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]), np.eye(4))
RIGHT = replace(LEFT, name="right", T_base_cam=np.eye(4) + 0.1 * np.eye(4, k=3))


def write_log(path: Path, rig: Rig, sets: int = 40, joints_per_set: int = 0, apart_ns: int = 0) -> None:
    """Images of all cameras, taken `apart_ns` one after the other by the rig's clock and stamped by their own."""
    with LogWriter(path) as log:
        write_rig(log, rig, START)
        for k in range(sets):
            taken = START + k * PERIOD
            for place, camera in enumerate(rig.cameras):
                stamp = camera.own_time(taken + place * apart_ns)
                log.write(f"/{camera.name}/camera_info", convert.camera_info(camera, stamp), taken)
                image = convert.raw_image(camera.name, stamp, np.zeros((24, 32, 3), np.uint8))
                log.write(f"/{camera.name}/image_raw", image, taken)
            for j in range(joints_per_set):
                stamp = taken + j * PERIOD // joints_per_set
                log.write("/joint_states", joints(stamp, np.zeros(1)), stamp)


def joints(stamp: int, positions: np.ndarray, name: str = "elbow") -> Message:
    return convert.joint_sample_to_message(JointSample(stamp, (name,), positions, np.zeros(1)))


@contextlib.contextmanager
def rewriting(source: Path, target: Path) -> Iterator[tuple[Iterator[LogMessage], LogWriter]]:
    """The messages of a log, and one to write them into that has its records already."""
    with open_log(source) as log, LogWriter(target) as written:
        for name, record in log.metadata.items():
            written.add_metadata(name, record)
        yield log.messages(), written


def checked(path: Path) -> LogCheck:
    with open_log(path) as log:
        return check_log(log)


@pytest.mark.parametrize("offset_ms", [0, 12, -12])
def test_cameras_whose_clocks_the_log_knows_are_not_apart(tmp_path: Path, offset_ms: int) -> None:
    """They were calibrated already: to say it again would send their user in a circle."""
    rig = Rig((LEFT, replace(RIGHT, time_offset_ns=offset_ms * MS)), BOX)
    write_log(tmp_path / "log.mcap", rig)
    assert checked(tmp_path / "log.mcap").faults == ()


def test_what_a_replay_would_refuse_is_found(tmp_path: Path) -> None:
    """A camera that looks up implies no workspace; one image of each is no set yet: nobody knows what comes next."""
    alone, seldom = tmp_path / "alone.mcap", tmp_path / "seldom.mcap"
    write_log(alone, Rig((LEFT,)))
    (fault,) = checked(alone).faults
    assert fault.startswith("camera left: expected views from different sides to derive the workspace from, or ")
    write_log(alone, Rig((LEFT,), BOX))
    assert checked(alone).faults == ()
    write_log(seldom, Rig((LEFT, RIGHT), BOX), sets=1, apart_ns=5 * MS)
    (fault,) = checked(seldom).faults
    assert fault.startswith("no set of images of left, right: their stamps lie too far apart, or too few")


def test_stamps_that_stand_have_no_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        for k in range(20):
            log.write("/joint_states", joints(START, np.zeros(1)), START + k * PERIOD)
    assert main(["check", str(tmp_path / "log.mcap")]) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("/joint_states")]
    assert "the clock that makes them stands" in line and " Hz" not in line


def test_what_a_twin_has_said_is_sound_without_images(tmp_path: Path) -> None:
    """They are in the log that it was made from: record's own default was called unsound."""
    path = tmp_path / "twin.mcap"
    write_twin_log(path)
    with open_log(path) as log:
        assert check_log(log).faults == ()


def test_cameras_that_are_apart_by_the_rigs_clock_are_named(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_log(path, Rig((LEFT, RIGHT)), apart_ns=12 * MS)
    (fault,) = checked(path).faults
    assert "camera 'right': images lie 12.0 ms from those of 'left'" in fault


@pytest.mark.parametrize("slow", ["left", "right"])
def test_a_camera_that_sends_more_slowly_is_not_said_to_be_apart(tmp_path: Path, slow: str) -> None:
    """Every one of its images is taken with one of the other's: no trigger and no clock is to blame."""
    write_log(tmp_path / "all.mcap", Rig((LEFT, RIGHT), BOX))
    with rewriting(tmp_path / "all.mcap", tmp_path / "slow.mcap") as (messages, written):
        for message in messages:
            if not message.topic.startswith(f"/{slow}/") or (message.stamp - START) // PERIOD % 2 == 0:
                written.write_raw(message.topic, message.msgtype, message.data, message.stamp)
    (fault,) = checked(tmp_path / "slow.mcap").faults
    fast = {"left": "right", "right": "left"}[slow]
    assert fault.startswith(f"camera '{slow}': 15.2 images per second beside 30.3 of '{fast}': sets come ")


def test_stamps_that_do_not_carry_over_to_seconds_are_told_as_that(tmp_path: Path) -> None:
    """As of a driver that counts nanoseconds alone: its times were told as the skew of a camera."""
    write_log(tmp_path / "all.mcap", Rig((LEFT, RIGHT), BOX))
    with rewriting(tmp_path / "all.mcap", tmp_path / "odd.mcap") as (messages, written):
        for message in messages:
            if message.topic == "/right/image_raw":
                content = message.message
                content.header.stamp.nanosec += 1_012_000_000
                written.write(message.topic, content, message.stamp)
            else:
                written.write_raw(message.topic, message.msgtype, message.data, message.stamp)
    found = checked(tmp_path / "odd.mcap")
    assert {topic.name: topic.faults for topic in found.topics if topic.faults} == {
        "/right/image_raw": (
            "40 of 40 stamps have a nanosec of 1e9 or more: whoever makes them does not carry it over to sec",
        )
    }
    assert not any("images lie" in fault for fault in found.faults)


def test_fixed_frames_that_are_put_elsewhere_are_named(tmp_path: Path) -> None:
    """The twin would go on with the first pose, and the space that it sees would be elsewhere."""
    path = tmp_path / "log.mcap"
    write_log(path, Rig((LEFT,), BOX))
    moved = LEFT.T_base_cam.copy()
    moved[0, 3] += 0.012
    with rewriting(path, tmp_path / "moved.mcap") as (messages, written):
        for message in messages:
            written.write_raw(message.topic, message.msgtype, message.data, message.stamp)
        for seconds, pose in ((0.1, LEFT.T_base_cam), (0.5, moved), (0.6, LEFT.T_base_cam), (0.7, moved)):
            stamp = START + int(seconds * 1e9)
            written.write("/tf_static", convert.tf_static(Rig((replace(LEFT, T_base_cam=pose),)), stamp), stamp)
    (fault,) = checked(tmp_path / "moved.mcap").faults
    assert fault.startswith("/tf_static: left_optical_frame moves by 12.0 mm and 0.0 degrees in base_link 0.5 s after")


def test_a_camera_that_begins_late_is_not_apart_from_the_others(tmp_path: Path) -> None:
    """What it shows belongs to theirs; that there is none in the first half is no other clock's doing."""
    write_log(tmp_path / "all.mcap", Rig((LEFT, RIGHT), BOX))
    with rewriting(tmp_path / "all.mcap", tmp_path / "late.mcap") as (messages, late):
        for message in messages:
            if not message.topic.startswith("/right/") or message.stamp > START + 30 * PERIOD:
                late.write_raw(message.topic, message.msgtype, message.data, message.stamp)
    assert checked(tmp_path / "late.mcap").faults == ()


@pytest.mark.parametrize(
    ("size", "encoding", "said"),
    [
        ((24, 32), "rgb16", "camera 'left': image of left_optical_frame at .*image encoding 'rgb16'"),
        ((48, 64), "rgb8", "camera 'left': images are 64x48, its CameraInfo is for 32x24"),
    ],
)
def test_images_that_no_twin_can_take_are_named(
    tmp_path: Path, size: tuple[int, int], encoding: str, said: str
) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        write_rig(log, Rig((LEFT,)), START)
        for k in range(10):
            stamp = START + k * PERIOD
            image = convert.raw_image("left", stamp, np.zeros((*size, 3), np.uint8))
            image.encoding = encoding
            log.write("/left/camera_info", convert.camera_info(LEFT, stamp), stamp)
            log.write("/left/image_raw", image, stamp)
    (fault,) = checked(path).faults
    assert re.match(said, fault)


def test_calibration_that_changes_within_a_log_is_told(tmp_path: Path) -> None:
    """A camera that was set to another mode, or calibrated anew: what came first was taken for the whole log."""
    path = tmp_path / "log.mcap"
    zoomed = replace(LEFT, K=np.array([[60.0, 0, 16], [0, 60, 12], [0, 0, 1]]))
    with LogWriter(path) as log:
        write_rig(log, Rig((LEFT,), BOX), START)
        for k in range(40):
            stamp = START + k * PERIOD
            log.write("/left/camera_info", convert.camera_info(LEFT if k < 30 else zoomed, stamp), stamp)
            log.write("/left/image_raw", convert.raw_image("left", stamp, np.zeros((24, 32, 3), np.uint8)), stamp)
    said = {topic.name: topic.faults for topic in checked(path).topics if topic.faults}
    assert list(said) == ["/left/camera_info"]
    assert said["/left/camera_info"][0].startswith("calibration changes 1.0 s after the start, and a twin takes the fi")


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("at", [0, 7, 39])
def test_joints_that_are_not_finite_are_found_wherever_they_are(tmp_path: Path, wrong: float, at: int) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for k in range(40):
            positions = np.array([wrong if k == at else 1.0])
            log.write("/joint_states", joints(START + k * PERIOD, positions), START + k * PERIOD)
    (topic,) = checked(path).topics
    assert topic.faults == ("1 message with positions that are not finite",)


def test_joints_that_end_a_replay_are_found(tmp_path: Path) -> None:
    """A log with them was called sound."""
    for wrong in ("uneven", "twice"):
        with LogWriter(tmp_path / f"{wrong}.mcap") as log:
            for k in range(40):
                message = joints(START + k * PERIOD, np.zeros(1))
                if wrong == "uneven" and k in (3, 9):
                    message.position = np.zeros(2)
                if wrong == "twice":
                    message.name, message.position, message.velocity = ["elbow"] * 2, np.zeros(2), np.zeros(2)
                log.write("/joint_states", message, START + k * PERIOD)
    (topic,) = checked(tmp_path / "uneven.mcap").topics
    assert topic.faults == ("2 messages with other numbers of positions or velocities than of names",)
    (topic,) = checked(tmp_path / "twice.mcap").topics
    assert topic.faults == ("messages name elbow more than once",)


@pytest.mark.parametrize(
    ("wrong", "found"),
    [
        ("backwards", "JointTrajectory point 1: time_from_start -0.5 s is not after 0 s"),
        ("short", "JointTrajectory point 1: 0 positions for 1 joints"),
        ("nan", "joint path: expected finite angles"),
        ("none", None),
    ],
)
def test_trajectories_that_end_a_replay_are_found(tmp_path: Path, wrong: str, found: str | None) -> None:
    """A log with them was called sound."""
    path = JointPath(("elbow",), START + np.array([0, 500 * MS]), np.zeros((2, 1)))
    with LogWriter(tmp_path / "log.mcap") as log:
        for k in range(4):
            message = convert.joint_path_to_message(path)
            if k == 1:
                message.points = []  # the arm is to stay where it is
            elif wrong == "backwards":
                message.points[1].time_from_start.sec, message.points[1].time_from_start.nanosec = -1, 500 * MS
            elif wrong != "none":
                message.points[1].positions = np.zeros(0) if wrong == "short" else np.array([np.nan])
            log.write("/arm/trajectory", message, START + k * PERIOD)
    (topic,) = checked(tmp_path / "log.mcap").topics
    if found is None:
        assert topic.faults == ()
    else:
        (fault,) = topic.faults
        assert fault.startswith(found)


URDF = """<robot name="r"><link name="base_link"/><link name="a"/><link name="b"/><link name="c"/>
<joint name="roll" type="continuous"><parent link="base_link"/><child link="a"/></joint>
<joint name="lift" type="prismatic"><parent link="base_link"/><child link="b"/><limit upper="9"/></joint>
<joint name="wrist" type="revolute"><parent link="a"/><child link="c"/><limit lower="-15.7" upper="8"/></joint></robot>
"""


def write_joints(path: Path, names: tuple[str, ...], positions: list[float], urdf: str | None = None) -> None:
    with LogWriter(path) as log:
        if urdf is not None:
            log.write("/robot_description", message_type("std_msgs/msg/String")(data=urdf), START)
        for k in range(40):
            stamp = START + k * PERIOD
            told = np.array(positions) * (k + 1) / 40
            sample = JointSample(stamp, names, told, np.zeros(len(names)))
            log.write("/joint_states", convert.joint_sample_to_message(sample), stamp)


@pytest.mark.parametrize(
    ("names", "positions", "urdf"),
    [
        (("left_wheel_joint", "right_wheel_joint"), [250.0, -31.0], None),
        (("roll", "lift", "wrist"), [40.0, 8.5, -15.75], URDF),
        (("pan", "elbow", "wrist_3_joint"), [1.0, -2.0, 19.0], None),
    ],
)
def test_joints_that_turn_on_and_on_are_not_taken_for_degrees(
    tmp_path: Path, names: tuple[str, ...], positions: list[float], urdf: str | None
) -> None:
    """A cart's wheels, a hinge without an end by the robot's description, and one of an arm whose others do turn."""
    write_joints(tmp_path / "log.mcap", names, positions, urdf)
    assert not any(topic.faults for topic in checked(tmp_path / "log.mcap").topics)


@pytest.mark.parametrize("urdf", [None, "no XML", "<robot/>", URDF])
def test_degrees_are_told_whatever_else_is_known(tmp_path: Path, urdf: str | None) -> None:
    """Where there is a description it says what turns on and on; of the others angles are told as before."""
    write_joints(tmp_path / "log.mcap", ("pan", "elbow", "wrist"), [90.0, -45.0, 20.0], urdf)
    *_, topic = sorted(checked(tmp_path / "log.mcap").topics, key=lambda topic: len(topic.faults))
    assert topic.faults[0].startswith(
        "positions up to 90.0 rad: more than a turn; are they degrees? If pan turns on and"
    )


def test_a_long_recording_of_joints_is_held_in_few_bytes(tmp_path: Path) -> None:
    """500 of them a second: an hour took half a gigabyte."""
    delays = np.random.default_rng(0).integers(0, 1_000_000, 200_000).tolist()
    tracemalloc.start()
    try:
        assert clock_step(array("q", range(len(delays))), array("q", delays)) is None
        assert tracemalloc.get_traced_memory()[1] < 100 * len(delays)
    finally:
        tracemalloc.stop()


def test_a_report_expects_sets_at_the_cameras_rate(tmp_path: Path) -> None:
    """An arm tells its joints at up to 500 Hz: taken for sets, they left a report a second of the whole log."""
    write_log(tmp_path / "log.mcap", Rig((LEFT,)), sets=60, joints_per_set=16)
    with LogSession(tmp_path / "log.mcap") as session:
        assert session.expected_hz(None) == pytest.approx(1e9 / PERIOD, rel=0.05)


def test_an_arm_and_its_gripper_on_one_topic_are_judged_each_by_itself(tmp_path: Path) -> None:
    """The gripper's clock is behind, and three of its messages are missing; the arm's joints are as they should be."""
    said = [(START + k * 8 * MS, "elbow", 0) for k in range(100)]
    said += [(START + k * 20 * MS + 3 * MS, "finger", -2) for k in range(40) if k not in (10, 11, 12)]
    with LogWriter(tmp_path / "log.mcap") as log:
        for stamp, name, behind_s in sorted(said):
            log.write("/joint_states", joints(stamp + behind_s * 1000 * MS, np.zeros(1), name), stamp)
    [topic] = checked(tmp_path / "log.mcap").topics
    assert topic.faults == (
        "finger: 1 gap, the longest 80 ms",
        "finger: stamped 2.0 s before the time of recording: another clock",
    )
    assert topic.statistics.count == len(said) and topic.statistics.rate_hz == pytest.approx(125)


def test_stamps_that_stand_still_are_named(tmp_path: Path) -> None:
    """As of a driver that never asks for the time."""
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for k in range(40):
            log.write("/joint_states", joints(START, np.zeros(1)), START + k * MS)
    [topic] = checked(path).topics
    assert topic.faults == ("most stamps are the same as the one before: the clock that makes them stands",)
