"""The chain on a real recording: it must beat the frozen first frame where things move, and foresee them."""

from __future__ import annotations

import json

import pytest
from quick_reports import without_left_out

from twin_node.cli import main
from twin_node.resources import find


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, float]]:
    """The report of 2.5 s of `pusht_3cam`, in which the arm swings in, at 10 Hz in lockstep."""
    rig = find("calibration/pusht_3cam_refined.yaml")
    if not (rig.resolve().parents[2] / "shared" / "data" / "pusht_3cam").is_dir():
        pytest.skip("the recording pusht_3cam is not at hand (looked in ../shared/data)")
    folder = tmp_path_factory.mktemp("pusht")
    log = folder / "log.mcap"
    assert main(["import", "video", str(rig), "-o", str(log)]) == 0
    arguments = ["--lockstep", "--duration", "2.5", "--max-rate", "10", "--width", "160", "--report", str(folder)]
    with without_left_out():
        assert main(["replay", str(log), *arguments]) == 0
    report: dict[str, dict[str, float]] = json.loads((folder / "report.json").read_text())
    return report


def test_moving_pixels_beat_the_frozen_first_frame_by_4_db(figures: dict[str, dict[str, float]]) -> None:
    quality = figures["quality"]
    assert quality["psnr_moving_db"] >= quality["frozen_psnr_moving_db"] + 4


def test_what_moved_had_been_foreseen_better_than_by_persistence(figures: dict[str, dict[str, float]]) -> None:
    forecast = figures["forecast"]
    assert forecast["recall"] > 0.9
    assert forecast["recall"] > forecast["baselines"]["persistence"]["recall"]
    assert forecast["moving_volume_l"] < forecast["baselines"]["worst_case"]["moving_volume_l"]
