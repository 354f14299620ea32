"""`calibrate hand-eye`, `refine` and `time` from the command line."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log
from twin_node.cli import main
from twin_node.cli.calibrate_motion import _with_other_clocks
from twin_node.messages import header_stamp, to_time
from twin_node.rig import RigFile, load_rig, save_rig
from twin_node.rig.evidence import CameraEvidence
from twin_node.scene import Rig, RigCamera

AHEAD_NS = 500_000_000


def test_hand_eye_of_a_folder(recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "wrist.yaml"
    assert main(["calibrate", "hand-eye", str(recordings / "hand_eye"), "-o", str(out), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["mean_reprojection_px"] <= 0.5
    assert 0.005 < figures["cameras"]["camera"]["sigma_m"] < 0.015  # halves of the stops differ by 20 mm
    written = load_rig(out)
    assert written.frame == "tool0"
    assert written.rig.cameras[0].T_base_cam.tolist() == figures["cameras"]["camera"]["T_carrier_camera"]
    assert main(["calibrate", "hand-eye", str(recordings / "hand_eye"), "--fixed-intrinsics", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cameras"]["camera"]["sigma_m"] < 0.005


def test_refine_refuses_in_one_line_and_writes_nothing(
    cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "refined.yaml"
    assert main(["calibrate", "refine", str(cell_log(1.2)), "-o", str(out), "--duration", "0.1"]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("twin_node: error: ")]
    assert len(lines) == 1
    assert not out.exists()


def test_refine_of_a_log_with_depth(
    cell_log: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Surfaces tell how the cameras stand: no time is spent on a plane."""
    monkeypatch.delattr("twin_node.model.plane.dominant_plane")
    out = tmp_path / "refined.yaml"
    assert main(["calibrate", "refine", str(cell_log(1.2)), "-o", str(out), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["surfaces_mm"] < 5
    first = load_rig(out)
    assert [camera.name for camera in first.rig.cameras] == list(figures["cameras"])
    of_a_board = CameraEvidence(0.1, 0.1, 20, 400, 1e-8 * np.eye(6), np.ones(9), 0.001, 5.0)
    clock = {"time_offset_ns": 12_000_000, "time_rate_ppm": 30.0, "time_reference_ns": 20_000_000_000}
    timed = replace(first.rig, cameras=tuple(replace(camera, **clock) for camera in first.rig.cameras))
    of_videos = replace(first, rig=timed, evidence=(of_a_board,) * len(timed.cameras))
    save_rig(of_videos, tmp_path / "board.yaml")
    given = ["--rig", str(tmp_path / "board.yaml")]
    assert main(["calibrate", "refine", str(cell_log(1.2)), *given, "-o", str(out)]) == 0
    for camera, now in zip(first.rig.cameras, load_rig(out).evidence, strict=True):  # poses and lenses are others now
        assert now is not None and now.pose_covariance is not None
        assert np.sqrt(np.diag(now.pose_covariance)[:3]).max() < 0.02, camera.name
        clock_alone = CameraEvidence(time_offset_sigma=0.001, time_rate_sigma_ppm=5.0)
        assert replace(now, pose_covariance=None) == clock_alone
    for camera in load_rig(out).rig.cameras:  # of stamps that count from a recording's start: not of this log's
        assert {name: getattr(camera, name) for name in clock} == clock


def test_refine_times_the_clocks_too(
    cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One file with places and clocks; where the arm hardly moves, the places alone, and a warning.

    A camera by another clock is timed from where the recording puts it, and placed.
    """
    little = ("--arm", "ur5e", "--duration", "1")
    out, log, narrow = tmp_path / "refined.yaml", str(tmp_path / "log.mcap"), ("--max-offset", "0.05")
    with open_log(cell_log(2.0, width=240, height=180)) as read, LogWriter(log) as written:
        for one in read.messages():
            message = one.message
            if one.topic.startswith("/cam_left/"):
                at = to_time(header_stamp(message) + AHEAD_NS)
                message = replace(message, header=replace(message.header, stamp=at))
            written.write(one.topic, message, one.stamp)
    assert main(["calibrate", "refine", log, "-o", str(out), "--json", "--time", *narrow]) == 0
    captured = capsys.readouterr()
    clocks = json.loads(captured.out)["clocks"]
    assert "camera 'cam_left': images are stamped 0.500 s after the others'" in captured.err
    assert abs(clocks["cameras"]["cam_left"]["offset_ns"] + AHEAD_NS) < 50_000_000
    file = load_rig(out)
    ahead = next(camera for camera in file.rig.cameras if camera.name == "cam_left")
    start = 1_700_000_000_000_000_000
    assert abs(ahead.rig_time(start + AHEAD_NS) - start) < 50_000_000
    assert list(clocks["cameras"]) == [camera.name for camera in file.rig.cameras]
    assert file.evidence is not None and all(
        one is not None and one.time_offset_sigma is not None for one in file.evidence
    )
    assert main(["calibrate", "refine", log, "-o", str(out), "--json", "--time", *narrow, *little]) == 0
    captured = capsys.readouterr()
    assert "clocks are left as they are" in captured.err and "clocks" not in json.loads(captured.out)


def test_time_says_what_is_missing(cell_log: Callable[..., Path], refused: Callable[..., str]) -> None:
    assert "expected at least 20 images to time its motion by, found" in refused(
        "calibrate", "time", cell_log(1.2), "--duration", "0.3"
    )


def test_a_clock_that_was_found_goes_before_one_of_other_stamps(tmp_path: Path) -> None:
    """Of the others nothing is known but what the file said, and they are said to be left as they are."""
    K = np.array([[60.0, 0, 31], [0, 60, 23], [0, 0, 1]])
    plain = (RigCamera("left", 64, 48, K, np.eye(4)), RigCamera("right", 64, 48, K, np.eye(4)))
    live = {"time_offset_ns": 12_000_000, "time_rate_ppm": 30.0, "time_reference_ns": 1_760_000_000 * 10**9}
    save_rig(RigFile(Rig(tuple(replace(camera, **live) for camera in plain))), tmp_path / "live.yaml")
    found = replace(plain[1], time_offset_ns=-5_000_000, time_reference_ns=20 * 10**9)
    told = _with_other_clocks(Namespace(rig=tmp_path / "live.yaml"), RigFile(Rig((plain[0], found))))
    assert [camera.time_offset_ns for camera in told.rig.cameras] == [12_000_000, -5_000_000]
    assert [camera.time_rate_ppm for camera in told.rig.cameras] == [30.0, 0.0]
