"""Options that would change nothing are refused by their names: who gives one expects something of it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from twin_node.cli import main

RIG, BOARD = "calibration/pusht_3cam.yaml", "chessboard:9x6:0.025"


@pytest.fixture
def poses(tmp_path: Path) -> Path:
    """A session of one picture, whose pose is given as it is."""
    cv2.imwrite(str(tmp_path / "stop.png"), np.zeros((32, 32), np.uint8))
    pose = "{x: 0, y: 0, z: 0, qx: 0, qy: 0, qz: 0, qw: 1}"
    (tmp_path / "cal_data.yaml").write_text(f"- {{image: stop.png, pose: {pose}}}\n")
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "named", "why"),
    [
        (["bench", "forecast", "--speed", "--noise", "0.1"], "--noise", "expected with trajectories"),
        (["bench", "forecast", "--speed", "--fps", "10", "--seed", "0"], "--fps, --seed", "expected with trajectories"),
        (["bench", "forecast", "--speed", "--height", "1.8"], "--height", "expected with a file of trajectories"),
        (["bench", "forecast", "--made-up", "--joints", "hand"], "--joints", "expected with a file of trajectories"),
        (["bench", "viewer", "--rounds", "2"], "--rounds", "expected with --latency"),
        (["bench", "viewer", "-p", "synchronizer.width:=64"], "--param", "expected with --latency"),
        (["bench", "methods", "--rig", "rig.yaml"], "--rig", "expected with recorded data"),
        (["bench", "methods", "--hold-out", "front"], "--hold-out", "expected with recorded data"),
        (["demo", "--port", "8081"], "--port", "expected with --viewer"),
        (["export", "a.mcap", "--to", "csv", "-o", "a", "--arm", "ur5e", "--params", "p.yaml"], "--arm", "expected"),
        (["calibrate", "hand-eye", "x", "--camera", "left"], "--camera", "expected with --rig"),
        (["calibrate", "hand-eye", "{poses}", "--arm", "ur5e"], "--arm", "expected with stops that give `joints`"),
        (["calibrate", "check", RIG, "--board", BOARD, "--duration", "5"], "--board, --duration", "expected with"),
        (["calibrate", "check", RIG, "{poses}", "--arm", "ur5e", "--remap", "/a:=/b"], "--arm, --remap", "exp"),
        (["calibrate", "check", RIG, "a.mcap", "--board", BOARD], "--board", "expected with a folder of recordings"),
        (["calibrate", "report", RIG, "--board", BOARD, "-o", "{poses}/a.html"], "--board", "expected with rec"),
        (
            ["calibrate", "rig", "x", "-o", "{poses}/r.yaml", "--lenses", RIG, "--model", "equidistant"],
            "--model",
            "exp",
        ),
        (["calibrate", "refine", "x", "-o", "{poses}/r.yaml", "--arm", "ur5e"], "--arm", "expected with --time"),
        (["calibrate", "refine", "x", "-o", "{poses}/r.yaml", "--width", "16"], "--width", "expected with --time"),
        (["calibrate", "refine", "x", "-o", "{poses}/r.yaml", "--max-offset", "1"], "--max-offset", "expected with --"),
        (["ur-driver", "--robot", "x", "--mode", "servo", "--play"], "--play", "expected with --mode slider"),
        (
            ["ur-driver", "--robot", "x", "--mode", "read-only", "--register", "21"],
            "--register",
            "expected with --mode",
        ),
        (
            ["ur-driver", "--robot", "x", "--mode", "read-only", "--resume"],
            "--resume",
            "expected with a mode in which halts",
        ),
        (["record", "-a", "/tf", "/twin/status"], "--all", "expected instead of topics, found /tf, /twin/status too"),
    ],
)
def test_an_option_that_would_change_nothing_is_refused_alone(
    arguments: list[str],
    named: str,
    why: str,
    poses: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("twin_node.bench.forecast_speed.run", None)  # what is not refused fails
    monkeypatch.setattr("twin_node.cell.load_scenario", None)
    monkeypatch.setattr("twin_node.nodes.live.single.run_single", None)
    assert main([one.format(poses=poses) for one in arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"twin_node: error: {named}: {why}")
