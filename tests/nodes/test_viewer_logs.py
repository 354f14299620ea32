"""The viewer with logs that hold less, more or other things than a twin's usually do."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twin_logs import PERIOD, START, cloud_at

from twin_node.bag import LogWriter, RecordingWriter, open_log
from twin_node.bench.visitors import free_port
from twin_node.cli import main
from twin_node.messages import MessageError, convert
from twin_node.nodes.cloud_updates import CloudUpdates
from twin_node.nodes.overlays import moving_mask
from twin_node.nodes.playback import Playback
from twin_node.nodes.topics import (
    GAUSSIANS,
    GAUSSIANS_CHANGED,
    GAUSSIANS_MOVING,
    JOINT_STATES,
    OBSTACLES,
    OCCUPANCY,
    SEPARATION,
    TRAJECTORY,
)
from twin_node.nodes.viewer import CellPage, LogViewer
from twin_node.robot import RobotError, forward_kinematics, ur_model
from twin_node.scene import (
    GaussianCloud,
    Grid,
    JointPath,
    JointSample,
    ObstacleKind,
    Occupancy,
    OccupancyLayer,
    Separation,
)

pytest.importorskip("viser")

NO_RUNS = np.empty((0, 2), np.uint32)


@pytest.mark.parametrize("swallows", ["set_cameras", "show"])
def test_an_interrupt_that_a_library_swallows_ends_the_page(
    twin_log: Path, monkeypatch: pytest.MonkeyPatch, swallows: str
) -> None:
    """As modules do that catch whatever interrupts their import: at the start, and at the first picture."""
    pictures: list[str] = []

    def swallow(*_: object) -> None:
        pictures.append(swallows)
        assert len(pictures) < 5, "it goes on"
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    def draw(*_: object) -> None:
        pictures.append("show")
        assert len(pictures) < 5, "it goes on"

    monkeypatch.setattr(CellPage, "take_change", lambda self: True)
    monkeypatch.setattr(CellPage, "show", draw)
    monkeypatch.setattr(CellPage, swallows, swallow)
    before = signal.getsignal(signal.SIGINT)
    assert main(["view", str(twin_log), "--port", str(free_port())]) == 130
    assert signal.getsignal(signal.SIGINT) is before


@pytest.fixture
def page() -> Iterator[CellPage]:
    made = CellPage(ur_model("ur5e"), (), port=free_port())
    yield made
    made.close()


def shown(page: CellPage, *logs: Path, seconds: float = 0.5) -> Callable[[str], Any]:
    """Shows a time of the logs; looks up what is in the scene by its name, None where it is not visible."""
    with Playback(logs, 80) as playback:
        page.set_cameras(playback.cameras)
        page.show(playback.at(START + round(seconds * 1e9)))

    def find(name: str) -> Any:
        handle = page.server.scene.get_handle_by_name(name)
        return handle if handle is not None and handle.visible else None

    return find


def part_of(log: Path, out: Path, *left_out: str) -> Path:
    """The log without some topics."""
    with open_log(log) as whole, RecordingWriter(out) as part:
        for message in whole.messages([topic.name for topic in whole.topics if topic.name not in left_out]):
            part.write(message.topic, message.msgtype, bytes(message.data), message.stamp, message.types)
    return out


def test_all_of_a_twin_is_shown(page: CellPage, twin_log: Path) -> None:
    find = shown(page, twin_log)
    for name in ("/gaussians/static", "/gaussians/moving", "/arm/forearm_link", "/obstacles/MOVING/BOX"):
        assert find(name) is not None, name
    assert len(find("/obstacles/MOVING/SPHERE").batched_positions) == 1


def test_without_an_arm_there_is_none(page: CellPage, twin_log: Path, tmp_path: Path) -> None:
    find = shown(page, part_of(twin_log, tmp_path / "part.mcap", JOINT_STATES))
    assert find("/arm/forearm_link") is None and find("/arm_ahead/forearm_link") is None
    assert find("/gaussians/static") is not None


def test_without_a_forecast_nothing_is_occupied(page: CellPage, twin_log: Path, tmp_path: Path) -> None:
    page.voxels.horizon, page.voxels.is_static_shown, page.voxels.is_unknown_shown = 0, True, True
    find = shown(page, part_of(twin_log, tmp_path / "part.mcap", OBSTACLES))
    assert find("/obstacles/MOVING/BOX") is None and find("/occupancy/moving") is None
    assert find("/gaussians/moving") is not None


def test_layers_of_the_forecast_are_points_where_the_voxels_are(page: CellPage, tmp_path: Path) -> None:
    grid = Grid(np.array([0.0, 0.0, 0.0]), 0.1, (4, 4, 4))
    certain = np.full(2, 255, np.uint8)
    layers = tuple(OccupancyLayer(50_000_000 * k, np.array([k, 8 + k], np.uint32), certain) for k in range(5))
    standing = OccupancyLayer(0, np.array([20, 21], np.uint32), certain)
    said = Occupancy(START, START, grid, layers, standing, np.array([[40, 3]], np.uint32))
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(OCCUPANCY, convert.occupancy_to_message(said), START)
    page.voxels.horizon, page.voxels.is_unknown_shown = 3, True
    find = shown(page, tmp_path / "a.mcap", seconds=0)
    assert np.allclose(find("/occupancy/moving").points, grid.centers(np.array([3, 11])), atol=1e-3)
    assert np.allclose(find("/occupancy/unknown").points, grid.centers(np.array([40, 41, 42])), atol=1e-3)
    assert find("/occupancy/static") is None


@pytest.mark.parametrize(("seconds", "is_seen"), [(0.2, True), (0.3, False)])
def test_moving_space_goes_with_its_forecast(
    page: CellPage, cell_log: Callable[..., Path], tmp_path: Path, seconds: float, is_seen: bool
) -> None:
    """Its last horizon is over 200 ms after it was published; what stands goes on standing."""
    grid = Grid(np.array([0.0, 0.0, 0.0]), 0.1, (4, 4, 4))
    certain = np.full(1, 255, np.uint8)
    layers = tuple(OccupancyLayer(50_000_000 * k, np.array([k], np.uint32), certain) for k in range(5))
    said = Occupancy(START, START, grid, layers, OccupancyLayer(0, np.array([20], np.uint32), certain), NO_RUNS)
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(OCCUPANCY, convert.occupancy_to_message(said), START)
    page.voxels.horizon, page.voxels.is_static_shown = 0, True
    find = shown(page, tmp_path / "a.mcap", cell_log(0.5), seconds=seconds)
    assert (find("/occupancy/moving") is not None) == is_seen
    assert find("/occupancy/static") is not None
    with Playback([tmp_path / "a.mcap", cell_log(0.5)], 80) as playback:
        snapshot = playback.at(START + round(seconds * 1e9))
        assert (moving_mask(snapshot, playback.cameras[0], 0) is not None) == is_seen


def test_a_path_that_is_over_no_longer_leads_the_arm(page: CellPage, tmp_path: Path) -> None:
    """Somebody moves the arm by hand since: where it will be follows from its joints."""
    arm = ur_model("ur5e")
    with LogWriter(tmp_path / "a.mcap") as log:
        path = JointPath(arm.joint_names, START + np.array([0, PERIOD]), np.array([np.zeros(6), np.full(6, 0.5)]))
        log.write(TRAJECTORY, convert.joint_path_to_message(path), START)
        for k in range(10):
            turned = np.array([0.1 * k, -1.2, 1.4, -1.8, -1.5, 0.0])
            sample = JointSample(START + k * PERIOD, arm.joint_names, turned, np.array([1.0, 0, 0, 0, 0, 0]))
            log.write(JOINT_STATES, convert.joint_sample_to_message(sample), sample.stamp)
    for seconds, ahead in ((0.1, np.full(6, 0.5)), (0.5, np.array([0.7, -1.2, 1.4, -1.8, -1.5, 0.0]))):
        ghost = shown(page, tmp_path / "a.mcap", seconds=seconds)("/arm_ahead/forearm_link")
        assert np.allclose(ghost.position, forward_kinematics(arm, ahead)[3, :3, 3], atol=1e-6)


def test_a_decision_that_is_old_says_so(page: CellPage, tmp_path: Path) -> None:
    """An arm's node that has died leaves its last words: full speed may be among them."""
    decided = Separation(START, START, 1.0, 0.5, *np.zeros(5).tolist(), "forearm_link", 7, 1.0, "nothing near")
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(SEPARATION, convert.separation_to_message(decided), START)
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), START + 9 * 10**9), START + 9 * 10**9)
    shown(page, tmp_path / "a.mcap", seconds=2)
    assert page._arm_words.content.startswith("### Speed 100%")
    shown(page, tmp_path / "a.mcap", seconds=6)
    assert page._arm_words.content.startswith("**There has been no decision about the arm for 6 s.**")


def test_images_of_one_camera_are_in_its_frustum(
    page: CellPage, twin_log: Path, cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    with open_log(cell_log(0.5)) as log:
        others = [topic.name for topic in log.topics if topic.name.startswith(("/cam_left/", "/cam_back/"))]
    one = part_of(cell_log(0.5), tmp_path / "one.mcap", *others)
    find = shown(page, twin_log, one, seconds=0.4)
    assert find("/cameras/cam_front").image.shape[1] == 80
    assert find("/cameras/cam_left") is None and find("/cameras/cam_back") is None


def test_arm_and_moving_space_are_tinted_on_the_images(
    page: CellPage, twin_log: Path, cell_log: Callable[..., Path]
) -> None:
    """The arm of the log's joints is in the picture: tinted there, and the image as it was elsewhere."""
    plain = shown(page, twin_log, cell_log(0.5), seconds=0.4)("/cameras/cam_front").image.astype(int)
    page.frusta.is_masked = True
    tinted = shown(page, twin_log, cell_log(0.5), seconds=0.4)("/cameras/cam_front").image.astype(int)
    changed = (plain != tinted).any(axis=2)
    assert 0.005 < changed.mean() < 0.5
    assert (tinted[changed][:, 2] > plain[changed][:, 2]).mean() > 0.9  # towards blue


def cloud_log(path: Path, cloud: GaussianCloud) -> Path:
    with LogWriter(path) as log:
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud, START), START)
        log.write(GAUSSIANS_MOVING, convert.gaussians_to_pointcloud2(cloud.only(cloud.tiers > 0), START), START)
    return path


def test_no_gaussians_are_no_splats(page: CellPage, tmp_path: Path) -> None:
    find = shown(page, cloud_log(tmp_path / "a.mcap", cloud_at(0, True).only(np.zeros(50, np.bool_))), seconds=0)
    assert find("/gaussians/static") is None and find("/gaussians/moving") is None


def test_splats_that_are_gone_are_taken_away(page: CellPage, twin_log: Path, tmp_path: Path) -> None:
    assert shown(page, twin_log)("/gaussians/moving") is not None
    still = cloud_at(0, True)
    find = shown(page, cloud_log(tmp_path / "a.mcap", still.only(still.tiers == 0)), seconds=0)
    assert find("/gaussians/static") is not None and find("/gaussians/moving") is None


def test_what_began_to_move_stands_again_when_time_goes_back(page: CellPage, tmp_path: Path) -> None:
    """Five of what stood move from 0.3 s on, before the next whole cloud; somebody seeks to before that."""
    cloud = cloud_at(0, True)
    moved = replace(cloud, tiers=np.where(cloud.ids < 35, cloud.tiers, 2).astype(np.uint8))
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud, START), START)
        stamp = START + 3 * PERIOD
        log.write(GAUSSIANS_MOVING, convert.gaussians_to_pointcloud2(moved.only(moved.tiers > 0), stamp), stamp)
    assert len(shown(page, tmp_path / "a.mcap", seconds=0.3)("/gaussians/static").centers) == 35
    find = shown(page, tmp_path / "a.mcap", seconds=0.1)
    assert len(find("/gaussians/static").centers) == 40 and len(find("/gaussians/moving").centers) == 10


def test_what_comes_to_rest_is_shown_and_what_is_gone_is_not(page: CellPage, tmp_path: Path) -> None:
    """Before the next whole cloud five of what moved rest, and five of what stood are gone."""
    cloud = cloud_at(0, True)
    moving = np.flatnonzero(cloud.tiers > 0)
    tiers, alive = cloud.tiers.copy(), np.ones(50, np.bool_)
    tiers[moving[:5]] = 0
    alive[np.flatnonzero(cloud.tiers == 0)[:5]] = False
    updates = CloudUpdates()
    updates.whole(cloud)
    stamp = START + 3 * PERIOD
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud, START), START)
        now = replace(cloud, tiers=tiers).only(alive)
        log.write(GAUSSIANS_CHANGED, convert.gaussians_to_pointcloud2(updates.changed(now), stamp), stamp)
        log.write(GAUSSIANS_MOVING, convert.gaussians_to_pointcloud2(now.only(now.tiers > 0), stamp), stamp)
    find = shown(page, tmp_path / "a.mcap", seconds=0.3)
    assert len(find("/gaussians/static").centers) == 40 and len(find("/gaussians/moving").centers) == 5


def test_two_hundred_thousand_gaussians_are_shown(page: CellPage, tmp_path: Path) -> None:
    cloud = cloud_at(0, True).only(np.arange(200_000) % 50)
    find = shown(
        page, cloud_log(tmp_path / "a.mcap", replace(cloud, ids=np.arange(200_000, dtype=np.uint32))), seconds=0
    )
    assert len(find("/gaussians/static").centers) == 160_000 and len(find("/gaussians/moving").centers) == 40_000


def test_joints_of_another_arm_are_an_error_that_names_them_and_the_rest_is_drawn(
    page: CellPage, twin_log: Path, tmp_path: Path
) -> None:
    """The arm as it was last shown is not shown any more."""
    find = shown(page, twin_log)
    assert find("/arm/forearm_link") is not None and find("/arm_ahead/forearm_link") is not None
    with LogWriter(tmp_path / "a.mcap") as log:
        sample = JointSample(START, ("axis_1", "axis_2"), np.zeros(2), np.zeros(2))
        log.write(JOINT_STATES, convert.joint_sample_to_message(sample), START)
    page._obstacles.set_visible(ObstacleKind.MOVING, False)
    with pytest.raises(RobotError, match="axis_1"):
        shown(page, twin_log, tmp_path / "a.mcap")
    assert find("/arm/forearm_link") is None and find("/arm_ahead/forearm_link") is None
    assert find("/obstacles/MOVING/BOX") is None


def test_a_gripper_s_joints_that_come_before_the_arm_s_are_no_problem_of_the_page(
    page: CellPage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = ur_model("ur5e")
    with LogWriter(tmp_path / "a.mcap") as log:
        for stamp, names in ((START, ("finger_joint",)), (START + PERIOD // 20, arm.joint_names)):
            sample = JointSample(stamp, names, np.zeros(len(names)), np.zeros(len(names)))
            log.write(JOINT_STATES, convert.joint_sample_to_message(sample), stamp)
    told: list[str | None] = []
    monkeypatch.setattr(page, "tell", told.append)
    with Playback([tmp_path / "a.mcap"]) as playback:
        viewer, rounds = LogViewer(playback, page), iter((False, False))

        def is_over() -> bool:
            if told:
                viewer.seek(0.1)
            return next(rounds, True)

        viewer.run(is_over)
    assert told == [None, None]
    assert page.server.scene.get_handle_by_name("/arm/forearm_link").visible


def test_a_message_that_cannot_be_shown_is_told_and_others_are_shown(
    page: CellPage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arm's joints are no angles from 0.1 to 0.2 s: somebody who plays the log is not thrown out there."""
    arm = ur_model("ur5e")
    with LogWriter(tmp_path / "a.mcap") as log:
        for k, angle in enumerate((0.1, np.nan, 0.1)):
            sample = JointSample(START + k * PERIOD, arm.joint_names, np.full(6, angle), np.zeros(6))
            log.write(JOINT_STATES, convert.joint_sample_to_message(sample), sample.stamp)
    told: list[str | None] = []
    monkeypatch.setattr(page, "tell", told.append)
    with Playback([tmp_path / "a.mcap"]) as playback:
        viewer, times = LogViewer(playback, page), iter((0.0, 0.1, 0.2))

        def is_over() -> bool:
            time = next(times, None)
            viewer.seek(time or 0.0)
            return time is None

        viewer.run(is_over)
        assert told[0] is None and told[2] is None
        assert told[1] is not None and "is not finite" in told[1]


def test_an_image_that_cannot_be_shown_takes_no_other_camera_s_away(
    page: CellPage, twin_log: Path, cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    bad = "/cam_back/image_raw/compressed"
    with open_log(cell_log(0.5)) as log, RecordingWriter(tmp_path / "damaged.mcap") as damaged:
        for message in log.messages():
            length = len(message.data) // 2 if message.topic == bad else len(message.data)
            data = bytes(message.data)[:length]
            damaged.write(message.topic, message.msgtype, data, message.stamp, message.types)
    with pytest.raises(MessageError, match=f"^{bad} at "):
        shown(page, twin_log, tmp_path / "damaged.mcap", seconds=0.4)
    find = page.server.scene.get_handle_by_name
    assert find("/cameras/cam_back").image is None
    assert all(find(f"/cameras/{name}").image is not None for name in ("cam_front", "cam_left"))


def test_time_before_the_first_word_is_an_empty_page(
    page: CellPage, twin_log: Path, cell_log: Callable[..., Path]
) -> None:
    """Also for those who seek back to it."""
    with Playback([twin_log, cell_log(0.5)], 80) as playback:
        page.set_cameras(playback.cameras)
        find = page.server.scene.get_handle_by_name
        for _ in range(2):
            page.show(playback.at(START - PERIOD))
            assert find("/gaussians/static") is None and find("/gaussians/moving") is None
            assert not find("/arm/forearm_link").visible and find("/cameras/cam_front").image is None
            page.show(playback.at(START + 5 * PERIOD))
            assert find("/gaussians/static").visible and find("/cameras/cam_front").image is not None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["notes.txt"], "notes.txt"),
        (["missing.mcap"], "missing.mcap"),
        ([], "expected a LOG, or --live"),
        (["a.mcap", "--live"], "expected a LOG, or --live"),
        (["a.mcap", "--endpoint", "tcp/127.0.0.1:1"], "--endpoint is for --live"),
        (["LOG", "--arm", "ur99"], "ur99"),
        (["LOG", "--host", "198.51.100.7"], "cannot be opened"),
        (["LOG", "--rig", "missing.yaml"], "missing.yaml"),
        (["LOG", "--host", ""], "--host: expected an address, found none"),
        (["LOG", "--at", "7"], "--at 7: expected a time inside the log's 0 to 1.400 s"),
        (["--live", "--at", "7"], "--at: expected with a LOG"),
        (["--live", "--endpoint", "nonsense"], "expected addresses such as tcp/127.0.0.1:7447"),
    ],
)
def test_wrong_wishes_are_one_line(
    twin_log: Path,
    cell_log: Callable[..., Path],
    tmp_path: Path,
    refused: Callable[..., str],
    arguments: list[str],
    message: str,
) -> None:
    (tmp_path / "notes.txt").write_text("not a log")
    logs = [str(twin_log), str(cell_log(0.5))]
    assert message in refused(
        "view", *(part for argument in arguments for part in (logs if argument == "LOG" else [argument]))
    )
