"""Clocks that are set within a recording, and what only looks as if they were."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log
from twin_node.messages import convert
from twin_node.nodes.clock_steps import camera_clock_steps, clock_step
from twin_node.nodes.log_check import check_log
from twin_node.nodes.player import span_of

MS = 1_000_000
START = 1_700_000_000_000 * MS
PERIOD = 33 * MS


def arrivals(count: int = 90) -> np.ndarray:
    """A camera at 30 Hz whose images take 20 ms, give or take 3, until they are recorded."""
    rng = np.random.default_rng(0)
    return START + np.arange(count) * PERIOD + (20 + rng.uniform(-3, 3, count)) * MS


@pytest.mark.parametrize("step_ms", [100, -100, 60, -3_600_000])
@pytest.mark.parametrize("at", [15, 40, 75])
def test_a_step_is_told_where_it_is(step_ms: int, at: int) -> None:
    stamps = START + np.arange(90) * PERIOD
    stamps[at:] += step_ms * MS
    found = clock_step(stamps.tolist(), (arrivals() - stamps).astype(np.int64).tolist())
    assert found is not None
    assert abs(found.step_ns - step_ms * MS) < 5 * MS
    assert abs(found.stamp - stamps[at - 1]) <= 3 * PERIOD


def test_what_is_no_step_is_not_told() -> None:
    stamps = START + np.arange(90) * PERIOD
    slow_disk = arrivals()
    slow_disk[40:60] += np.linspace(600, 0, 20) * MS
    drifting = arrivals() + np.linspace(0, 40, 90) * MS
    missing = np.delete(np.arange(90), slice(30, 45))
    for taken, came in (
        (stamps, arrivals()),
        (stamps, slow_disk),
        (stamps, drifting),
        (stamps[missing], arrivals()[missing]),
        (stamps[:20], arrivals()[:20]),
    ):
        assert clock_step(taken.tolist(), (came - taken).astype(np.int64).tolist()) is None


def test_check_names_a_camera_whose_clock_was_set(tmp_path: Path) -> None:
    """Its images are as regular as before: a calibration of clocks would mix both times, and be sure of the mean."""
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for k in range(60):
            recorded = START + k * PERIOD
            for name, later in (("left", 0), ("right", 100 * MS if k >= 30 else 0)):
                image = convert.raw_image(name, recorded - 20 * MS + later, np.zeros((4, 4, 3), np.uint8))
                log.write(f"/{name}/image_raw", image, recorded)
    with open_log(path) as log:
        faults = {topic.name: " ".join(topic.faults) for topic in check_log(log).topics}
        steps = camera_clock_steps(log, {"/left/image_raw": "left", "/right/image_raw": "right"}, span_of(log))
    assert "stamps jump by +100 ms" in faults["/right/image_raw"]
    assert "stamps jump" not in faults["/left/image_raw"]
    assert {name: step.step_ns for name, step in steps.items()} == {"right": 100 * MS}
