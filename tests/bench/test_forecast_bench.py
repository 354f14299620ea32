"""`bench forecast`: scores of trajectories with known futures, and made-up events that nobody could foresee."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from twin_node.bench import forecast, made_up
from twin_node.bench.errors import BenchError
from twin_node.cli import main


def write_csv(path: Path, seconds: float, rate: float = 60.0) -> Path:
    """A hand that swings below an elbow, both on a body that sways."""
    times = np.arange(0, seconds, 1 / rate)
    body = 0.2 * np.sin(2 * np.pi * 0.5 * times)
    hand = body + 0.3 * np.sin(2 * np.pi * 1.1 * times)
    rows = [f"{t},{b},0,1,{h},0,0.7" for t, b, h in zip(times, body, hand, strict=True)]
    path.write_text("\n".join(["time,elbow_x,elbow_y,elbow_z,hand_x,hand_y,hand_z", *rows]))
    return path


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> forecast.ForecastBench:
    path = write_csv(tmp_path_factory.mktemp("bench") / "swing.csv", 9.0)
    return forecast.run(path, forecast.ForecastBenchParameters(noise_m=0.001))


def test_a_swing_is_learnt_that_no_simple_forecast_can_follow(bench: forecast.ForecastBench) -> None:
    errors = bench.score.error_mm
    assert errors["ours"] < 0.5 * errors["constant_velocity"]
    assert errors["ours"] < 0.3 * errors["persistence"]
    assert errors["best_single"] == min(errors[name] for name in errors if name not in ("ours", "best_single"))
    assert errors["ours"] < 1.2 * errors["best_single"]


def test_the_bound_holds_what_it_promises_and_the_radii_say_at_what_price(bench: forecast.ForecastBench) -> None:
    assert bench.score.coverage > 0.97
    radii = bench.score.radius_m
    assert 0 < radii["median"] < 0.2
    assert radii["constant_same_coverage"] > bench.score.error_mm["ours"] * 1e-3
    assert 0.5 < bench.score.worst_case["coverage"] <= 1


def test_json_has_the_stable_names_and_every_joint(bench: forecast.ForecastBench) -> None:
    printed = json.loads(json.dumps(bench.as_json()))
    assert {"error_mm", "coverage", "target", "radius_m", "by_joint"} <= set(printed)
    assert {"ours", "persistence", "constant_velocity", "best_single"} <= set(printed["error_mm"])
    assert set(printed["radius_m"]) == {"median", "mean", "constant_same_coverage"}
    assert set(printed["by_joint"]) == {"elbow", "hand"}
    assert printed["target"] == 0.99


def test_nothing_is_known_of_the_time_between_samples_that_are_missing(tmp_path: Path) -> None:
    """A straight line across the gap was taken for the truth."""
    header, *rows = write_csv(tmp_path / "whole.csv", 6.0).read_text().splitlines()
    lost = range(220, 260)
    files = {
        "rows.csv": [row for number, row in enumerate(rows) if number not in lost],
        "cells.csv": [row.split(",")[0] + 6 * "," if number in lost else row for number, row in enumerate(rows)],
    }
    scores = []
    for name, kept in files.items():
        (tmp_path / name).write_text("\n".join([header, *kept]))
        scores.append(forecast.run(tmp_path / name, forecast.ForecastBenchParameters(noise_m=0.0)))
    assert scores[0].samples == scores[1].samples
    assert scores[0].score.error_mm["persistence"] == pytest.approx(scores[1].score.error_mm["persistence"])


def test_the_same_seed_gives_the_same_scores(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "swing.csv", 4.0)
    one, other = (forecast.run(path, forecast.ForecastBenchParameters(seed=2)).score for _ in range(2))
    assert one == other


def test_only_the_joints_asked_for_are_scored(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "swing.csv", 4.0)
    chosen = forecast.run(path, forecast.ForecastBenchParameters(joints=("HAND",)))
    assert set(chosen.by_joint) == {"hand"}
    with pytest.raises(BenchError, match="it has elbow, hand"):
        forecast.run(path, forecast.ForecastBenchParameters(joints=("knee",)))


def test_a_short_file_has_nothing_to_score(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"more than 2.2 s"):
        forecast.run(write_csv(tmp_path / "swing.csv", 2.0))


def test_points_that_come_and_go_are_scored_while_they_are_seen(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "swing.csv", 5.0)
    lines = path.read_text().splitlines()
    lines[181:211] = [",".join([*line.split(",")[:4], "", "", ""]) for line in lines[181:211]]  # half a second unseen
    path.write_text("\n".join(lines))
    bench = forecast.run(path)
    assert np.isfinite(bench.score.error_mm["ours"])
    whole = forecast.run(write_csv(tmp_path / "whole.csv", 5.0))
    assert bench.samples < whole.samples


def test_after_an_event_the_bound_holds_again() -> None:
    bench = made_up.run(seeds=1)
    assert set(bench.events) == set(made_up.KINDS)
    for name, aftermath in bench.events.items():
        assert aftermath.coverage >= 0.9, name
        assert (aftermath.recovery_s or 0) <= 1.3, name
    assert np.mean([aftermath.coverage for aftermath in bench.events.values()]) >= 0.95
    assert bench.events["start_from_rest"].radius_before_m < 0.1
    assert bench.events["teleport"].coverage_before == 0


def told_of(wide_s: float, end_s: float, ends_as_begun: bool) -> float | None:
    """Of a bound that is a hundred times as wide for so long after an event."""
    times = np.arange(-4, end_s, 1 / 30) + 1e-3
    radii = np.where((times >= 0) & (times < wide_s), 5.0, 0.05)[:, None] * np.ones(3)
    foretold = forecast.Foretold(np.zeros_like(radii), np.zeros((1, *radii.shape)), radii, 0.0)
    return made_up._recovery_s(made_up._Observed(times, foretold, ends_as_begun))


def test_a_bound_that_stays_wide_is_told_where_the_motion_comes_back() -> None:
    for wide_s in (0.0, 1.0, 3.9, 4.2, 5.0):
        assert told_of(wide_s, 5.0, True) == pytest.approx(wide_s, abs=0.04)
    assert told_of(1.0, 5.0, False) == pytest.approx(1.0, abs=0.04)
    assert told_of(1.0, 1.0, False) is None
    throw = made_up.KINDS["throw"](np.array([1.0, 0, 0]), 1.0)
    assert throw.flight_s <= 1 and not throw.ends_as_begun


def test_the_command_prints_json_and_refuses_what_it_cannot_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_csv(tmp_path / "swing.csv", 4.0)
    assert main(["bench", "forecast", str(path), "--noise", "0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["error_mm"]["ours"] < 50
    assert main(["bench", "forecast", str(tmp_path / "missing.bvh")]) == 2
    assert "missing.bvh" in capsys.readouterr().err
    (tmp_path / "notes.txt").write_text("hello")
    assert main(["bench", "forecast", str(tmp_path / "notes.txt")]) == 2
    assert "expected a .bvh, .trc or .csv" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--made-up", "--noise", "-1"], "expected 0 or more"),
        (["--made-up", "--noise", "nan"], "expected a finite number"),
        (["--made-up", "--fps", "9"], "--fps: expected 10 or more"),
        (["--made-up", "--seed", "-1"], "expected a whole number, 0 or more"),
        (["--made-up", "--joints", "hand"], "--joints: expected with a file"),
        (["--speed", "--height", "2"], "--height: expected with a file"),
    ],
)
def test_wrong_numbers_and_what_would_be_ignored_are_refused(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = main(["bench", "forecast", *arguments])
    except SystemExit as refused:
        status = int(str(refused.code))
    assert status == 2 and says in capsys.readouterr().err


def test_real_motion_is_forecast_better_than_by_any_simple_rule(recordings: Path) -> None:
    bench = forecast.run(recordings / "mocap" / "01_01.bvh")
    errors, radii = bench.score.error_mm, bench.score.radius_m
    assert errors["ours"] <= 0.8 * min(errors["persistence"], errors["constant_velocity"])
    assert errors["ours"] <= 1.02 * errors["best_single"]
    assert 0.985 <= bench.score.coverage <= 0.995
    assert radii["mean"] <= radii["constant_same_coverage"]
    assert radii["median"] <= 0.8 * radii["constant_same_coverage"]
