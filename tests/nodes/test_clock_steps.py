"""Clocks that are set within a recording, and what only looks as if they were."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log
from twin_node.messages import convert
from twin_node.nodes.clock_steps import ClockStep, camera_clock_steps, clock_step
from twin_node.nodes.log_check import check_log
from twin_node.nodes.player import span_of

MS = 1_000_000
START = 1_700_000_000_000 * MS
PERIOD = 33 * MS


def arrivals(count: int = 90, give_ms: float = 3, seed: int = 0) -> np.ndarray:
    """A camera at 30 Hz whose images take 20 ms, give or take some, until they are recorded, ns."""
    rng = np.random.default_rng(seed)
    taken = START + np.arange(count) * PERIOD
    return taken + np.round((20 + rng.uniform(-give_ms, give_ms, count)) * MS).astype(np.int64)


def stepped(came: np.ndarray, *steps: tuple[int, int], clock: int = START) -> ClockStep | None:
    """What is told of images that came when they came, by a clock that is set on by `steps` (ms) at some of them."""
    stamps = clock + np.arange(len(came)) * PERIOD
    for at, step_ms in steps:
        stamps[at:] += step_ms * MS
    return clock_step(stamps.tolist(), (came - stamps).tolist())


@pytest.mark.parametrize("give_ms", [0, 3, 6])
@pytest.mark.parametrize("step_ms", [100, -100, 60, -3_600_000])
@pytest.mark.parametrize("at", [15, 40, 75])
def test_a_step_is_told_where_it_is(step_ms: int, at: int, give_ms: float) -> None:
    """To the message: what is used up to there is by one clock."""
    came = arrivals(give_ms=give_ms)
    found = stepped(came, (at, step_ms))
    assert found is not None
    assert abs(found.step_ns - step_ms * MS) <= 2 * give_ms * MS
    assert found.recorded == came[at - 1]


def test_a_message_that_came_late_beside_a_step_leaves_it_where_it_is() -> None:
    came = arrivals()
    came[[36, 44]] += 300 * MS
    found = stepped(came, (40, -100))
    assert found is not None
    assert found.recorded == came[39]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("steps", [((35, 100), (80, -2000)), ((35, -2000), (80, 100))])
def test_of_two_steps_the_larger_one_is_told(steps: tuple[tuple[int, int], ...], seed: int) -> None:
    """The one was told about which images happened to come more evenly."""
    found = stepped(arrivals(120, seed=seed), *steps)
    assert found is not None
    assert round(found.step_ns / (100 * MS)) == -20


@pytest.mark.parametrize("clock", [START, 0])
def test_a_step_is_told_by_the_time_of_the_recording(clock: int) -> None:
    """Of a camera that counts from when it was switched on, it was told decades before the start."""
    found = stepped(arrivals(give_ms=0), (40, -100), clock=clock)
    assert found is not None
    assert "stamps jump by -100 ms against the time of recording, 1.3 s after the start" in found.told(START)


def test_a_step_takes_half_a_second_of_messages_on_either_side() -> None:
    assert stepped(arrivals(30), (15, 100)) is not None
    for count in (0, 1, 10, 20, 29):  # a stream that has hardly begun is none to fail at
        assert stepped(arrivals(count), (count // 2, 100)) is None


def test_what_is_no_step_is_not_told() -> None:
    stamps = START + np.arange(90) * PERIOD
    slow_disk = arrivals()
    slow_disk[40:60] += np.arange(600, 0, -30) * MS
    drifting = arrivals() + np.arange(90) * MS * 4 // 9
    missing = np.delete(np.arange(90), slice(30, 45))
    for taken, came in (
        (stamps, arrivals()),
        (stamps, slow_disk),
        (stamps, drifting),
        (stamps[missing], arrivals()[missing]),
        (stamps[:20], arrivals()[:20]),
    ):
        assert clock_step(taken.tolist(), (came - taken).tolist()) is None


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
