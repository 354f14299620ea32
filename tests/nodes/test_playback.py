"""A log read by time: what had been said by then, no more and no less."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from twin_logs import MOMENTS, PERIOD, START, cloud_at

from twin_node.bag import LogMessage, LogWriter, open_log
from twin_node.cli import main
from twin_node.geometry import looking_at
from twin_node.messages import convert
from twin_node.nodes.export import LogSource
from twin_node.nodes.overlays import arm_mask
from twin_node.nodes.playback import Playback
from twin_node.nodes.topics import GAUSSIANS, JOINT_STATES, OCCUPANCY, TRAJECTORY, GraphError
from twin_node.robot import RobotError, robot_mask, ur_model
from twin_node.scene import Camera, JointPath, JointSample


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
@given(times=st.lists(st.integers(0, MOMENTS * PERIOD - 1), min_size=1, max_size=6))
def test_any_order_of_times_shows_the_same(twin_log: Path, times: list[int]) -> None:
    """Forward, backward and in jumps: the newest cloud of each time, standing and moving put together."""
    with Playback([twin_log]) as playback:
        for time in times:
            shown = playback.at(START + time)
            expected = cloud_at(time // PERIOD, True)
            assert shown.cloud is not None
            order = np.argsort(shown.cloud.ids)
            assert np.array_equal(shown.cloud.ids[order], expected.ids)
            assert np.allclose(shown.cloud.means[order], expected.means, atol=1e-6)
            assert shown.joints is not None
            assert shown.joints.positions[0] == pytest.approx(0.1 * (time // PERIOD))


def test_clouds_are_moved_on_to_a_time_near_their_own(twin_log: Path) -> None:
    with Playback([twin_log]) as playback:
        shown = playback.at(START + 3 * PERIOD + PERIOD // 2)
    cloud, now, later = shown.cloud, shown.cloud_now, shown.cloud_at(START + 9 * PERIOD)
    assert cloud is not None and now is not None and later is not None
    assert np.allclose(now.means, cloud.means + 0.05 * cloud.velocities, atol=1e-6)
    assert np.allclose(later.means, cloud.means + 0.2 * cloud.velocities, atol=1e-6)  # no farther than that is foreseen
    assert np.abs(cloud.velocities).max() > 0


def test_before_the_first_message_nothing_is_known(twin_log: Path) -> None:
    with Playback([twin_log]) as playback:
        shown = playback.at(START - 1)
        assert shown.cloud is None and shown.obstacles is None and shown.joints is None


@pytest.mark.parametrize(("late_s", "words"), [(0.5, None), (9e6, "9000000.0 s before"), (-60.0, "60.0 s after")])
def test_a_log_recorded_by_another_clock_than_that_of_its_stamps_is_told(
    twin_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], late_s: float, words: str | None
) -> None:
    """Its tables of obstacles were empty, in silence: none of them was valid at a time of the log."""
    late = tmp_path / "late.mcap"
    with open_log(twin_log) as log, LogWriter(late) as written:
        for entry in log.messages():
            written.write_raw(entry.topic, entry.msgtype, entry.data, entry.stamp + round(late_s * 1e9))
    assert main(["export", str(late), "--to", "csv", "-o", str(tmp_path / "out"), "--at", "0.2"]) == 0
    told = capsys.readouterr().err
    assert ("by another clock" in told) is (words is not None)
    assert words is None or f"/twin/obstacles is stamped {words} it was recorded" in told


@pytest.fixture
def gripper_log(tmp_path: Path) -> Path:
    """The arm tells its joints at 0 and 0.1 s, its gripper 1 ms after it and for 3 s more."""
    path = tmp_path / "gripper.mcap"
    arm = ur_model("ur10e")
    with LogWriter(path) as log:
        for k in range(32):
            stamp = START + k * PERIOD
            if k < 2:
                sample = JointSample(stamp, arm.joint_names, np.full(6, 0.1 * (k + 1)), np.zeros(6))
                log.write(JOINT_STATES, convert.joint_sample_to_message(sample), stamp)
            sample = JointSample(stamp + 1_000_000, ("finger_joint",), np.full(1, 0.7), np.zeros(1))
            log.write(JOINT_STATES, convert.joint_sample_to_message(sample), stamp + 1_000_000)
    return path


def test_a_grippers_joints_do_not_hide_the_arms(gripper_log: Path) -> None:
    arm = ur_model("ur10e")
    times = [START + int(s * 1e9) for s in (0.05, 0.15, 3.0)]
    with Playback([gripper_log]) as playback:
        shown = playback.at(times[0])
        assert shown.joints is not None and shown.joints.names == ("finger_joint",)
        moments = LogSource(playback).moments(times, arm, with_clouds=False)
        assert [None if m.q is None else m.q[0] for m in moments] == pytest.approx([0.1, 0.2, 0.2])
        camera = Camera("c", 32, 24, np.array([[20.0, 0, 16], [0, 20, 12], [0, 0, 1]]), np.eye(4))
        assert arm_mask(playback.at(times[1]), camera, arm, times[1]) is not None
        strange = replace(arm, joint_names=tuple(f"other_{name}" for name in arm.joint_names))
        with pytest.raises(RobotError, match="found finger_joint"):
            arm_mask(playback.at(times[1]), camera, strange, times[1])


def test_an_arm_is_shown_where_it_was_when_the_image_beside_it_was_taken(tmp_path: Path) -> None:
    """Of joints that come at 10 Hz the newest are up to 0.1 s old, those at 500 Hz newer than the image."""
    arm, path = ur_model("ur10e"), tmp_path / "turning.mcap"
    with LogWriter(path) as log:
        for k in range(3):
            told = JointSample(START + k * PERIOD, arm.joint_names, np.full(6, 0.1 * k), np.full(6, 1.0))
            log.write(JOINT_STATES, convert.joint_sample_to_message(told), told.stamp)
    camera = Camera(
        "c", 32, 24, np.array([[20.0, 0, 16], [0, 20, 12], [0, 0, 1]]), looking_at(np.array([2.0, 1, 1]), np.zeros(3))
    )
    with Playback([path]) as playback:
        for age_s in (-0.05, 0.0, 0.15):
            snapshot = playback.at(START + 2 * PERIOD)
            mask = arm_mask(snapshot, camera, arm, snapshot.stamp - int(age_s * 1e9))
            np.testing.assert_array_equal(mask, robot_mask(arm, np.full(6, 0.2 - age_s), camera))
        moments = LogSource(playback).moments([START + int(s * 1e9) for s in (0.05, 0.24, 2.0)], arm, False)
        assert [None if m.q is None else m.q[0] for m in moments] == pytest.approx([0.05, 0.24, 0.2])


def test_joints_are_unknown_until_the_arm_first_tells_and_known_however_long_ago(tmp_path: Path) -> None:
    """A gripper's are no other arm's where the arm's are only late, or come no more."""
    arm, path, finger = ur_model("ur10e"), tmp_path / "late.mcap", ("finger_joint",)
    told = [(0, finger), (1, arm.joint_names), (2, finger), (1000, finger)]
    with LogWriter(path) as log:
        for k, names in told:
            sample = JointSample(START + k * PERIOD, names, np.full(len(names), 0.3), np.zeros(len(names)))
            log.write(JOINT_STATES, convert.joint_sample_to_message(sample), sample.stamp)
    times = [START + k * PERIOD for k in (0, 1, 2, 1000)]
    with Playback([path]) as playback:
        moments = LogSource(playback).moments(times, arm, with_clouds=False)
        assert [None if m.q is None else m.q[0] for m in moments] == [None, 0.3, 0.3, 0.3]


def test_joints_told_long_ago_are_looked_for_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour of a gripper's joints, after the arm's were told last, was read anew for every picture."""
    arm, path, count = ur_model("ur10e"), tmp_path / "long.mcap", 2000
    with LogWriter(path) as log:
        for k in range(count):
            names = ("finger_joint",) if k else arm.joint_names
            sample = JointSample(START + k * PERIOD, names, np.full(len(names), 0.3), np.zeros(len(names)))
            log.write(JOINT_STATES, convert.joint_sample_to_message(sample), sample.stamp)
    read: list[int] = []
    with Playback([path]) as playback:
        messages = playback._messages

        def counted(topic: str, start: int | None = None, stop: int | None = None) -> Iterator[LogMessage]:
            for message in messages(topic, start, stop):
                read.append(message.stamp)
                yield message

        monkeypatch.setattr(playback, "_messages", counted)
        for k in (count // 2, count // 2 + 1, 3, count - 2, count - 1, count - 1):
            joints = playback.at(START + k * PERIOD).joints_of(arm.joint_names)
            assert joints is not None and joints.names == arm.joint_names
    assert len(read) < 3 * count


def test_topics_are_known_by_the_names_that_they_are_given(
    twin_log: Path, cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    """Images, calibration, poses and joints of another naming, each read under the graph's own."""
    given = {"cam_left/image_raw/compressed": "/eye/pictures", "cam_left/camera_info": "/eye/info"}
    given |= {"tf_static": "/robot/tf_static", "joint_states": "/robot/joint_states"}
    with open_log(cell_log(0.3)) as log, LogWriter(tmp_path / "foreign.mcap") as written:
        for message in log.messages():
            topic = given.get(message.topic.removeprefix("/"), message.topic)
            written.write_raw(topic, message.msgtype, message.data, message.stamp)
    remaps = {new: f"/{old}" for old, new in given.items()}
    with Playback([tmp_path / "foreign.mcap"], 80, remaps=remaps) as playback:
        assert [camera.name for camera in playback.cameras] == ["cam_back", "cam_front", "cam_left"]
        shown = playback.at(playback.end_ns)
        assert all(shown.view(camera.name) is not None for camera in playback.cameras)
        assert shown.joints is not None and shown.earlier(JOINT_STATES, 10**9)
        assert playback.at(playback.start_ns).camera_silent_s("cam_left") == 0.0
    with pytest.raises(GraphError, match=r"--remap /nowhere:=/tf_static: .*twin.mcap: no topic /nowhere"):
        Playback([twin_log], remaps={"/nowhere": "/tf_static"})


def test_images_come_from_the_log_that_has_them(twin_log: Path, cell_log: object) -> None:
    """The twin's log says when to look, the cell's what was seen."""
    seen = cell_log(0.5)
    with Playback([twin_log, seen], width=80) as playback:
        assert [camera.width for camera in playback.cameras] == [80, 80, 80]
        shown = playback.at(START + 400_000_000)
        assert all(shown.view(camera.name) is not None for camera in playback.cameras)
        assert (playback.start_ns, playback.end_ns) == (START, START + (MOMENTS - 1) * PERIOD)


@pytest.mark.parametrize("is_last", [True, False])
def test_a_log_that_only_names_a_topic_does_not_hide_it(twin_log: Path, tmp_path: Path, is_last: bool) -> None:
    """As a second recorder's does, that was told to take everything and got nothing."""
    idle = tmp_path / "idle.mcap"
    with LogWriter(idle) as log:
        log.add_topic(GAUSSIANS, "sensor_msgs/msg/PointCloud2")
        log.add_topic(OCCUPANCY, "twin_msgs/msg/OccupancyForecast")
        sample = JointSample(START, ("finger_joint",), np.full(1, 0.7), np.zeros(1))
        log.write("/gripper/joint_states", convert.joint_sample_to_message(sample), START)
    with Playback([twin_log, idle] if is_last else [idle, twin_log]) as playback:
        assert playback.at(START).whole_stamp == START
        playback.require(OCCUPANCY, "layers")


def test_a_missing_topic_is_named(twin_log: Path) -> None:
    with Playback([twin_log]) as playback:
        playback.require(GAUSSIANS, "this")
        with pytest.raises(GraphError, match=r"/twin/occupancy.*which layers needs"):
            playback.require(OCCUPANCY, "layers")


def test_a_trajectory_without_points_ends_the_one_before(tmp_path: Path) -> None:
    """As a controller is told to stay where it is: to show such a log is no error."""
    path = JointPath(("elbow_joint",), START + np.array([0, 10 * PERIOD]), np.array([[0.0], [1.0]]))
    begun, ended = convert.joint_path_to_message(path), convert.joint_path_to_message(path)
    ended.points = []
    with LogWriter(tmp_path / "paths.mcap") as log:
        log.write(TRAJECTORY, begun, START)
        log.write(TRAJECTORY, ended, START + 2 * PERIOD)
    with Playback([tmp_path / "paths.mcap"]) as playback:
        shown = playback.at(START + PERIOD).path
        assert shown is not None and shown.names == path.names
        assert playback.at(START + 3 * PERIOD).path is None


def test_depth_alone_shows_no_camera_and_says_so(twin_log: Path, tmp_path: Path) -> None:
    path = tmp_path / "depth.mcap"
    with LogWriter(path) as log:
        depth = convert.depth_image("front", START, np.ones((4, 6), np.float32))
        log.write("/front/depth/image_rect", depth, START)
    with Playback([twin_log, path]) as playback:
        assert playback.cameras == ()
        assert [line for line in playback.left_out if "depth.mcap: depth without colour images" in line]
        assert playback.at(START).cloud is not None
