"""The whole chain on a short log of the simulated cell: what it publishes, its report, and that it repeats itself."""

from __future__ import annotations

import html
import json
import os
import signal
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from quick_reports import without_left_out
from twin_logs import with_gripper

from twin_node.bag import LogWriter, open_log
from twin_node.cell.scenario import Fault
from twin_node.cli import main
from twin_node.messages import convert
from twin_node.model.model_process import ModelProcess
from twin_node.native_library import kernel_threads
from twin_node.nodes.arm_parameters import ArmParameters
from twin_node.nodes.chain_parameters import load_parameters
from twin_node.nodes.cloud_updates import SHOWN_COLOUR, updated
from twin_node.nodes.log_source import LogSession
from twin_node.nodes.replay import replay
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.topics import (
    GAUSSIANS,
    GAUSSIANS_CHANGED,
    GAUSSIANS_MOVING,
    OBSTACLES,
    OCCUPANCY,
    SEPARATION,
    STATUS,
    TRAJECTORY,
    GraphError,
)
from twin_node.scene import HORIZONS_NS, Grid, JointPath, ObstacleKind, Obstacles, Occupancy, Tier, TwinState

SECONDS = 1.2
WIDTH = "96"


@pytest.fixture(scope="module")
def lockstep(cell_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with `out.mcap` and the report of one lockstep replay, by one thread."""
    folder = tmp_path_factory.mktemp("lockstep")
    arguments = ["--lockstep", "--width", WIDTH, "--max-rate", "15", "--report", str(folder)]
    with kernel_threads(1):
        assert main(["replay", str(cell_log(SECONDS)), "-o", str(folder / "out.mcap"), *arguments]) == 0
    return folder


def test_every_set_gives_a_cloud_a_forecast_obstacles_and_a_decision(lockstep: Path) -> None:
    with open_log(lockstep / "out.mcap") as log:
        counts = {topic.name: topic.count for topic in log.topics}
    sets = counts[OCCUPANCY]
    assert sets >= 15
    assert counts[OBSTACLES] == counts[SEPARATION] == counts[GAUSSIANS_MOVING] == sets
    assert counts[GAUSSIANS] == counts[STATUS] == 2


def test_the_same_log_gives_the_same_bytes_by_two_threads_as_by_one(
    lockstep: Path, cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    again = tmp_path / "again.mcap"
    arguments = ["--lockstep", "--width", WIDTH, "--max-rate", "15"]
    with kernel_threads(2):
        assert main(["replay", str(cell_log(SECONDS)), "-o", str(again), *arguments]) == 0
    assert again.read_bytes() == (lockstep / "out.mcap").read_bytes()


def forecasts(path: Path) -> list[tuple[Occupancy, Obstacles]]:
    with open_log(path) as log:
        messages = {topic: [m.message for m in log.messages([topic])] for topic in (OCCUPANCY, OBSTACLES)}
    occupancies = [convert.occupancy_from_message(m) for m in messages[OCCUPANCY]]
    return list(zip(occupancies, map(convert.obstacles_from_message, messages[OBSTACLES]), strict=True))


def uncovered(grid: Grid, indices: np.ndarray, obstacles: Obstacles, stamp: int, kind: ObstacleKind) -> int:
    """How many of the voxels, whole, lie in no box of the kind that is valid at a stamp."""
    valid = (obstacles.valid_from <= stamp) & (stamp <= obstacles.valid_to) & (obstacles.kinds == kind)
    inside = np.zeros(grid.dims, bool)
    for position, size in zip(obstacles.positions[valid], obstacles.sizes[valid], strict=True):
        low, high = ((position + side * size / 2 - grid.origin) / grid.voxel_size for side in (-1, 1))
        inside[tuple(map(slice, np.maximum(np.ceil(low - 1e-9), 0).astype(int), np.floor(high + 1e-9).astype(int)))] = 1
    return int((~inside.ravel()[indices]).sum())


def test_every_occupied_voxel_is_inside_an_obstacle_at_its_time(lockstep: Path) -> None:
    seen = Counter[str]()
    for occupancy, obstacles in forecasts(lockstep / "out.mcap"):
        assert [layer.horizon_ns for layer in occupancy.layers] == list(HORIZONS_NS)
        for layer in occupancy.layers:
            stamp = occupancy.publish_stamp + layer.horizon_ns
            assert uncovered(occupancy.grid, layer.indices, obstacles, stamp, ObstacleKind.MOVING) == 0
            assert uncovered(occupancy.grid, occupancy.static.indices, obstacles, stamp, ObstacleKind.STATIC) == 0
            seen["moving"] += len(layer.indices)
        seen["static"] += len(occupancy.static.indices)
    assert seen["moving"] > 1000
    assert seen["static"] > 1000


def test_moving_clouds_hold_no_static_gaussian(lockstep: Path) -> None:
    with open_log(lockstep / "out.mcap") as log:
        clouds = [convert.gaussians_from_pointcloud2(m.message) for m in log.messages([GAUSSIANS_MOVING])]
        [first, *_] = [convert.gaussians_from_pointcloud2(m.message) for m in log.messages([GAUSSIANS])]
    assert all((cloud.tiers != Tier.STATIC).all() for cloud in clouds)
    assert len(clouds[-1].means) > 50
    assert len(first.means) > 500


def test_clouds_between_two_whole_ones_make_the_second_of_the_first(lockstep: Path) -> None:
    with open_log(lockstep / "out.mcap") as log:
        first, second = log.messages([GAUSSIANS])
        topics = (GAUSSIANS_CHANGED, GAUSSIANS_MOVING)
        told = {entry.topic: entry.message for entry in log.messages(topics) if entry.stamp <= second.stamp}
    changed, moving = (convert.gaussians_from_pointcloud2(told[topic]) for topic in topics)
    made = updated(convert.gaussians_from_pointcloud2(first.message), changed, moving)
    whole = convert.gaussians_from_pointcloud2(second.message)
    order, ids = np.argsort(made.ids), np.argsort(whole.ids)
    assert np.array_equal(made.ids[order], whole.ids[ids]) and np.array_equal(made.tiers[order], whole.tiers[ids])
    assert np.abs(made.rgb[order] - whole.rgb[ids]).max() < SHOWN_COLOUR + 1 / 255
    assert np.abs(made.means[order] - whole.means[ids]).max() < 0.25 * whole.scales.max()


def test_the_report_holds_every_figure_by_its_name(lockstep: Path) -> None:
    figures = json.loads((lockstep / "report.json").read_text())
    assert figures["sets"] >= 15
    assert figures["followed"] == figures["sets"]
    assert figures["dropped"] == 0
    assert set(figures["latency_ms"]) == {"p50", "p95", "p99"}
    quality = figures["quality"]
    assert quality["psnr_db"] > 15
    assert quality["psnr_moving_db"] > quality["frozen_psnr_moving_db"]
    assert quality["psnr_arm_db"] > quality["frozen_psnr_arm_db"]
    assert set(quality["left_out"]) == {"cam_back", "cam_front", "cam_left"}
    assert set(figures["tiers"]) == {tier.name.lower() for tier in Tier}
    forecast = figures["forecast"]
    assert set(forecast["baselines"]) == {"persistence", "constant_velocity", "worst_case"}
    for scores in (forecast, *forecast["baselines"].values()):
        assert {"recall", "recall_now", "recall_new", "volume_l", "inflation", "iou", "error_mm"} <= set(scores)
    assert forecast["truth"] == "/truth/occupancy"
    assert set(figures["arm"]) == {"min_distance_m", "min_speed_fraction", "contacts", "is_made_up"}
    assert not figures["arm"]["is_made_up"]
    assert {"parameters", "bytes_per_frame", "peak_rss_mb", "rate_hz"} <= set(figures)
    for name, value in forecast.items():
        if value is None:
            assert f"forecast.{name}" in figures["reasons"]
    for name in ("published_psnr_moving_db", "moved_on_psnr_moving_db"):
        assert quality[name] is None
        assert "lockstep" in figures["reasons"][f"quality.{name}"]


def test_the_page_stands_alone_and_shows_pictures(lockstep: Path) -> None:
    page = (lockstep / "report.html").read_text()
    assert page.count("data:image/png;base64,") >= 8
    assert "://" not in page  # no address: base64 may hold any letters, but no colon
    assert json.loads((lockstep / "report.json").read_text())["forecast"]["iou"] is None
    assert "<th>moving volume</th>" in page and "<th>IoU</th>" not in page  # no column of dashes


def test_real_time_counts_what_it_drops(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    report, alone, out = tmp_path / "report", tmp_path / "alone.yaml", tmp_path / "out.mcap"
    alone.write_text("model: {ros__parameters: {own_process: false}}\n")
    arguments = ["--rate", "20", "--width", WIDTH, "--report", str(report), "--params", str(alone), "-o", str(out)]
    with without_left_out():
        assert main(["replay", str(cell_log(SECONDS)), *arguments]) == 0
    figures = json.loads((report / "report.json").read_text())
    assert figures["dropped"] > 0
    assert figures["sets"] >= 2
    assert 30 <= figures["sets"] + figures["dropped"] <= 40
    assert figures["sets"] // 2 <= figures["followed"] <= figures["sets"]
    with open_log(cell_log(SECONDS)) as log, open_log(out) as written:
        (*_, last) = written.messages([SEPARATION])
        seconds = max(SECONDS, (last.stamp - log.start_ns) / 1e9) / 20
    assert figures["rate_hz"] == pytest.approx(figures["sets"] / seconds, rel=0.1)
    assert figures["quality"]["published_psnr_moving_db"] is not None
    page = html.unescape((report / "report.html").read_text())
    assert "replayed in real time at 20 times the log's pace" in page
    assert "moving pixels, by the newest cloud that was out when the image was taken" in page


def test_sets_per_second_are_those_of_the_time_that_they_took(cell_log: Callable[..., Path]) -> None:
    """No computer reads a log a thousand times as fast: it was said to have made thousands of sets per second."""
    parameters = replace(load_parameters(None), synchronizer=SynchronizerParameters(width=64))
    parameters = replace(parameters, model=replace(parameters.model, own_process=False))
    with LogSession(cell_log(0.6)) as session, replay(session, parameters, rate=1000) as run:
        last = run.collector.separations[-1]
        took_s = (last.stamp - session.span.start_ns) / 1e9 / 1000
    assert took_s > 2 * session.span.seconds / 1000
    assert run.seconds == pytest.approx(took_s, rel=0.1)


def test_in_real_time_the_model_follows_in_a_process_of_its_own(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    report, out = tmp_path / "report", tmp_path / "out.mcap"
    arguments = ["--rate", "1", "--width", WIDTH, "--report", str(report), "-o", str(out)]
    with without_left_out():
        assert main(["replay", str(cell_log(SECONDS)), *arguments]) == 0
    figures = json.loads((report / "report.json").read_text())
    assert 2 <= figures["followed"] <= figures["sets"]
    assert figures["quality"]["psnr_db"] > 15
    assert figures["parameters"] > 14 * 500
    assert figures["peak_rss_mb"] > 300, "of both processes"
    with open_log(out) as log:
        counts = {topic.name: topic.count for topic in log.topics}
    assert (counts[OCCUPANCY], counts[GAUSSIANS_MOVING]) == (figures["sets"], figures["followed"])


def test_in_real_time_the_first_decision_is_made_for_the_arm_that_the_log_tells_of(
    cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    """Not for a made-up one, nor for the gripper that tells of itself on the same topic."""
    parameters = replace(
        load_parameters(None), synchronizer=SynchronizerParameters(width=64), arm=ArmParameters("ur5e")
    )
    parameters = replace(parameters, model=replace(parameters.model, own_process=False))
    with LogSession(with_gripper(cell_log(0.3), tmp_path / "gripper.mcap"), duration_s=0.2) as session:
        first = []
        for rate in (None, 1.0):
            with replay(session, parameters, rate=rate) as run:
                first.append(run.collector.separations[0])
    lockstep, real_time = first
    assert real_time.evidence_stamp == lockstep.evidence_stamp
    assert real_time.distance == pytest.approx(lockstep.distance)


@pytest.mark.parametrize(("rate", "time"), [(None, ", 0.200 s after the log's start"), (1.0, "")])
def test_a_trajectory_that_no_arm_goes_along_is_told_with_its_log(
    cell_log: Callable[..., Path], tmp_path: Path, rate: float | None, time: str
) -> None:
    """It was told as one of nobody's, with all its points."""
    path = tmp_path / "log.mcap"
    arm = ArmParameters("ur5e")
    with open_log(cell_log(0.5)) as read, LogWriter(path) as log:
        for name, record in read.metadata.items():
            log.add_metadata(name, record)
        for message in read.messages():
            if message.topic != TRAJECTORY or message.stamp < read.start_ns + 200_000_000:
                log.write_raw(message.topic, message.msgtype, message.data, message.stamp)
                continue
            stamps = message.stamp + np.arange(3) * 100_000_000
            nowhere = JointPath(names=arm.arm().joint_names, stamps=stamps, positions=np.full((3, 6), np.nan))
            log.write(TRAJECTORY, convert.joint_path_to_message(nowhere), message.stamp)
    parameters = replace(load_parameters(None), synchronizer=SynchronizerParameters(width=64), arm=arm)
    parameters = replace(parameters, model=replace(parameters.model, own_process=False))
    with LogSession(path) as session, pytest.raises(GraphError) as error, replay(session, parameters, rate=rate):
        pass
    why = "joint values: expected finite angles of at most 1e+06 rad, found nan; check the arm's driver"
    assert str(error.value) == f"{path}: {TRAJECTORY}{time}: {why}"


def test_where_the_models_process_dies_the_run_ends_in_one_line(
    cell_log: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Killed(ModelProcess):
        def follow(self, seen: TwinState) -> None:
            os.kill(self.pid, signal.SIGKILL)
            super().follow(seen)

    monkeypatch.setattr("twin_node.nodes.model.ModelProcess", Killed)
    monkeypatch.setattr("twin_node.nodes.model.is_worth_it", lambda: True)
    out = tmp_path / "out.mcap"
    assert main(["replay", str(cell_log(SECONDS)), "--rate", "1", "--width", WIDTH, "-o", str(out)]) == 2
    [line] = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert "ended with status -9" in line and "own_process" in line
    assert not list(tmp_path.iterdir()), "nothing half-written is left"


def test_start_and_duration_choose_a_part_of_the_log(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    part = ["--start-offset", "0.5", "--duration", "0.3", "--lockstep", "--width", WIDTH]
    assert main(["replay", str(cell_log(SECONDS)), "-o", str(out), *part]) == 0
    with open_log(cell_log(SECONDS)) as log, open_log(out) as written:
        evidence = [convert.occupancy_from_message(m.message).stamp for m in written.messages([OCCUPANCY])]
        begin = log.start_ns + 500_000_000
    assert begin - 50_000_000 <= min(evidence)
    assert max(evidence) <= begin + 350_000_000


def test_a_log_that_shows_nothing_is_not_blamed_on_stamps(
    cell_log: Callable[..., Path], tmp_path: Path, refused: Callable[..., str]
) -> None:
    """Behind their caps, cameras were said to have stamps too far apart."""
    dark, black = tmp_path / "dark.mcap", convert.compressed_image("", 0, np.zeros((240, 320, 3), np.uint8))
    with open_log(cell_log(SECONDS)) as log, LogWriter(dark) as written:
        for message in log.messages():
            if message.topic.endswith("/image_raw/compressed"):
                message.message.data = black.data
            if "/depth/" not in message.topic:
                written.write(message.topic, message.message, message.stamp)
    told = refused("replay", dark, "-o", tmp_path / "out.mcap", "--duration", "0.3", "--lockstep")
    assert "sets of cam_back, cam_front, cam_left show nothing, black or burnt out" in told
    assert not (tmp_path / "out.mcap").exists()


def test_a_truncated_log_is_replayed_up_to_the_damage(
    cell_log: Callable[..., Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    data = cell_log(SECONDS).read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    out = tmp_path / "out.mcap"
    assert main(["replay", str(cut), "-o", str(out), "--lockstep", "--width", WIDTH, "--max-rate", "10"]) == 0
    assert "twin_node: warning:" in capfd.readouterr().err
    with open_log(out) as log:
        assert {topic.name for topic in log.topics} >= {OCCUPANCY, SEPARATION}


def test_a_camera_that_comes_later_is_left_out_in_turn_like_the_others(
    cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    log = cell_log(0.8, Fault("missing", "cam_left", 0.0, 0.4))
    arguments = ["--lockstep", "--width", WIDTH, "--max-rate", "10", "--report", str(tmp_path)]
    assert main(["replay", str(log), *arguments]) == 0
    left_out = json.loads((tmp_path / "report.json").read_text())["quality"]["left_out"]
    assert sorted(left_out) == ["cam_back", "cam_front", "cam_left"]


def test_a_foreign_log_works_through_rig_and_remap(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """Topics with other names, and calibration from a rig file instead of the log's own."""
    from twin_node.nodes.log_source import LogSession
    from twin_node.rig import RigFile, save_rig

    foreign, rig = tmp_path / "foreign.mcap", tmp_path / "rig.yaml"
    with LogSession(cell_log(SECONDS)) as session:
        save_rig(RigFile(session.rig), rig)
        with LogWriter(foreign) as log:
            for message in session.log.messages():
                if message.topic.endswith("/image_raw/compressed"):
                    topic = message.topic.replace("/image_raw/compressed", "/video/feed")
                    log.write_raw(topic, message.msgtype, message.data, message.stamp)
    remaps = []
    for camera in ("cam_front", "cam_left", "cam_back"):
        remaps += ["--remap", f"/{camera}/video/feed:=/{camera}/image_raw/compressed"]
    out = tmp_path / "out.mcap"
    arguments = ["--rig", str(rig), *remaps, "--lockstep", "--width", WIDTH, "--duration", "0.3"]
    assert main(["replay", str(foreign), "-o", str(out), *arguments]) == 0
    with open_log(out) as log:
        assert {topic.name for topic in log.topics} >= {OCCUPANCY, SEPARATION}
