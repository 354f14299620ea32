from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import BagError, open_log, read_rig_record
from twin_node.cell import CellSource, CellTruth, Scenario, SimulatedRig, write_log
from twin_node.cell.record import LEAST_TRUTH_RATE_HZ, Recording
from twin_node.cell.scenario import Fault
from twin_node.messages import header_stamp
from twin_node.messages.convert import (
    TransformTree,
    depth_from_message,
    joint_path_from_message,
    joint_sample_from_message,
    occupancy_from_message,
    rgb_from_message,
    rig_camera,
)


@pytest.fixture(scope="module")
def log(small: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cell") / "small.mcap"
    write_log(small, path)
    return path


def test_the_log_has_every_topic_at_its_rate(log: Path) -> None:
    counts = {topic.name: topic.count for topic in open_log(log).topics}
    for camera in ("cam_front", "cam_left", "cam_back"):
        for topic in ("camera_info", "image_raw/compressed", "depth/image_rect"):
            assert counts.pop(f"/{camera}/{topic}") == 15
    assert counts == {"/tf_static": 1, "/joint_states": 63, "/arm/trajectory": 5, "/truth/occupancy": 15}


@pytest.mark.parametrize(("duration_s", "count"), [(1.1, 110), (1.105, 111), (2.0, 200)])
def test_joints_are_told_until_the_scenarios_end(small: Scenario, duration_s: float, count: int) -> None:
    """1.1 x 100 is 110.00000000000001, and one sample more was of the time after the end."""
    assert small.arm is not None
    arm = replace(small.arm, joint_rate_hz=100.0)
    entries = Recording(replace(small, duration_s=duration_s, arm=arm))._joint_states()
    stamps = [entry.stamp for entry in entries]
    assert len(stamps) == count
    assert stamps[-1] < small.start_ns + duration_s * 1e9


@pytest.mark.parametrize(("rate_hz", "parts"), [(30.0, 1), (20.0, 1), (15.0, 2), (10.0, 2), (4.0, 5)])
def test_truth_is_told_often_enough_to_judge_forecasts_by(small: Scenario, rate_hz: float, parts: int) -> None:
    """Of a cell at 15 Hz every forecast came due half a period from any truth, and a report told no recall."""
    scenario = replace(small, sensing=replace(small.sensing, rate_hz=rate_hz))
    recording = Recording(scenario)
    ticks, stamps = SimulatedRig(scenario).tick_stamps(), recording._truth_stamps()
    assert stamps[::parts] == ticks
    assert len(stamps) == (len(ticks) - 1) * parts + 1
    assert (np.diff(stamps) > 0).all()
    assert np.diff(stamps).max() * 1e-9 <= 1 / LEAST_TRUTH_RATE_HZ + 0.01  # exposures jitter
    assert recording.count == sum(1 for _ in recording.entries())


def test_the_log_carries_the_rig_and_where_it_comes_from(log: Path, small: Scenario) -> None:
    reader, expected = open_log(log), SimulatedRig(small).rig
    assert expected.workspace is not None
    assert np.array_equal(read_rig_record(reader).workspace, expected.workspace)
    assert reader.metadata["twin_node.scenario"] == {"name": "demo", "seed": "1"}
    tree = TransformTree()
    tree.add(next(reader.messages(["/tf_static"])).message)
    for camera in expected.cameras:
        info = next(reader.messages([f"/{camera.name}/camera_info"])).message
        T_base_cam = tree.lookup(info.header.frame_id)
        read = rig_camera(info, camera.name, T_base_cam)
        assert np.allclose(read.K, camera.K)
        assert np.allclose(read.T_base_cam, camera.T_base_cam)


def test_images_joints_and_truth_survive_the_log(log: Path, small: Scenario) -> None:
    first = next(iter(CellSource(small)))
    simulated = SimulatedRig(small)
    truth = CellTruth(simulated)
    read = {}
    for item in open_log(log).messages():
        read.setdefault(item.topic, item.message)
    for view in first.views:
        image = read[f"/{view.camera.name}/image_raw/compressed"]
        depth = read[f"/{view.camera.name}/depth/image_rect"]
        assert header_stamp(image) == header_stamp(depth) == view.stamp
        assert header_stamp(read[f"/{view.camera.name}/camera_info"]) == view.stamp
        assert np.abs(rgb_from_message(image).astype(int) - view.rgb).mean() < 4
        assert np.array_equal(depth_from_message(depth), view.depth)
    occupancy = occupancy_from_message(read["/truth/occupancy"])
    assert np.array_equal(occupancy.layers[0].indices, truth.moving_voxels(truth.grid, occupancy.stamp))
    arm = simulated.world.arm
    assert arm is not None
    joints = joint_sample_from_message(read["/joint_states"])
    path = joint_path_from_message(read["/arm/trajectory"], 0)
    assert np.allclose(joints.positions, arm.sample(joints.stamp).positions)
    assert np.allclose(path.positions, arm.positions(path.stamps))
    assert path.stamps[-1] - path.stamps[0] >= 400_000_000


def test_messages_are_in_order_of_time_and_progress_reaches_the_end(small: Scenario, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    write_log(replace(small, duration_s=0.2), tmp_path / "log.mcap", lambda done, total: told.append((done, total)))
    stamps = [item.stamp for item in open_log(tmp_path / "log.mcap").messages()]
    assert stamps == sorted(stamps)
    assert told[-1][0] == told[-1][1] == len(stamps) - 1


def test_the_same_scenario_gives_the_same_bytes(small: Scenario, tmp_path: Path) -> None:
    short = replace(small, duration_s=0.15)
    for name, scenario in (("a", short), ("b", short), ("c", short.with_seed(7))):
        write_log(scenario, tmp_path / f"{name}.mcap")
    a, b, c = ((tmp_path / f"{name}.mcap").read_bytes() for name in "abc")
    assert a == b != c


def test_faults_reach_the_log(small: Scenario, tmp_path: Path) -> None:
    faults = (Fault("nan_depth", "cam_left"), Fault("unsorted_stamps", "cam_front"), Fault("missing", "cam_back"))
    write_log(replace(small, duration_s=0.2, faults=faults), tmp_path / "log.mcap")
    items = list(open_log(tmp_path / "log.mcap").messages())
    seen = Counter(item.topic for item in items)
    assert not any(topic.startswith("/cam_back/") for topic in seen)
    stamps = [header_stamp(item.message) for item in items if item.topic == "/cam_front/image_raw/compressed"]
    assert stamps != sorted(stamps)
    depth = next(item.message for item in items if item.topic == "/cam_left/depth/image_rect")
    assert depth.encoding == "32FC1" and np.isnan(depth.data.view(np.float32)).all()
    assert not depth_from_message(depth).any()


def test_nothing_is_left_where_the_log_cannot_be_written(small: Scenario, tmp_path: Path) -> None:
    with pytest.raises(BagError, match="folder"):
        write_log(small, tmp_path / "nowhere" / "log.mcap")

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_log(small, tmp_path / "log.mcap", stop)
    assert list(tmp_path.iterdir()) == []
