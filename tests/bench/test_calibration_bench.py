"""Made-up rigs: three of the benchmark's meet its targets."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest

from twin_node.bench.calibration import differences, laid_over
from twin_node.bench.simulated_rigs import RigSpread, simulated_rig
from twin_node.cli import main
from twin_node.geometry import pose
from twin_node.rig.calibrate.rotations import moved


def test_three_rigs_meet_the_targets(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """From recordings of less than half the benchmark's length, which tell enough."""
    monkeypatch.setattr("twin_node.bench.calibration.RigSpread", partial(RigSpread, seconds=25.0))
    assert main(["bench", "calibration", "--rigs", "3", "--first-seed", "4", "--processes", "1", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["worst"]["position_mm"] <= 2
    assert figures["worst"]["turn_deg"] <= 0.1
    assert figures["worst"]["offset_ms"] <= 1
    assert figures["ellipsoid_coverage"] >= 0.97
    assert len(figures["each"]) == 3


def test_no_rig_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["bench", "calibration", "--rigs", "0"])
    assert "--rigs" in capsys.readouterr().err


def test_a_rig_moved_as_a_whole_is_no_error() -> None:
    rig = simulated_rig(RigSpread(seconds=0.5), np.random.default_rng(3))
    rng = np.random.default_rng(0)
    whole = moved(pose(np.eye(3), np.zeros(3)), rng.normal(0, 0.3, 6))
    np.testing.assert_allclose(
        differences(laid_over(whole @ rig.T_base_cam, rig.T_base_cam), rig.T_base_cam), 0, atol=1e-9
    )


def test_the_same_seed_is_the_same_rig() -> None:
    first, second = (simulated_rig(RigSpread(seconds=0.5), np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first.T_base_cam, second.T_base_cam)
    np.testing.assert_array_equal(first.recordings[1].stamps, second.recordings[1].stamps)
