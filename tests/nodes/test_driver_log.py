"""The recording of a driver at work, by clocks that are set and beside others that differ."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin_node.bag import open_log
from twin_node.messages import convert
from twin_node.nodes.driver_log import DriverLog
from twin_node.nodes.put_back import Arrivals, PutBackClock
from twin_node.nodes.recorder import RecorderNode
from twin_node.nodes.topics import DIAGNOSTICS, SEPARATION
from twin_node.runtime.bus import LocalBus
from twin_node.scene import Separation

START = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


class SetClock:
    """A computer's, which somebody sets."""

    def __init__(self) -> None:
        self.stamp = START

    def now(self) -> int:
        return self.stamp


class Recorded:
    """A driver's recording of what goes over a bus."""

    def __init__(self, path: Path) -> None:
        self.said: list[str] = []
        self.bus, self.clock, self.log = LocalBus(), SetClock(), DriverLog(path, self.said.append)
        recorder = RecorderNode(self.bus, self.clock, self.log, (SEPARATION, DIAGNOSTICS), is_live=True)
        recorder.configure()
        recorder.activate()

    def diagnose(self) -> None:
        self.bus.publish(DIAGNOSTICS, convert.diagnostics_to_message(self.clock.now(), []))

    def decide(self, ahead_s: int) -> None:
        """By a clock that is ahead."""
        stamp = self.clock.now() + ahead_s * SECOND
        told = Separation.without_pair(stamp, stamp, 1.0, "clear")
        self.bus.publish(SEPARATION, convert.separation_to_message(told))


@pytest.fixture
def recorded(tmp_path: Path) -> Recorded:
    return Recorded(tmp_path / "arm.mcap")


def times(path: Path) -> list[int]:
    with open_log(path) as log:
        return [(entry.stamp - START) // SECOND for entry in log.messages()]


def test_a_clock_that_is_put_back_begins_another_recording(recorded: Recorded, tmp_path: Path) -> None:
    """Both times stood in one log, between each other."""
    for step_s in (0, 1, 1, -5, 1):
        recorded.clock.stamp += step_s * SECOND
        recorded.diagnose()
    recorded.log.close()
    second = tmp_path / "arm_r1.mcap"
    assert recorded.said == [f"time was put back by 5.0 s: what comes from now on is recorded into {second}"]
    assert (times(tmp_path / "arm.mcap"), times(second)) == ([0, 1, 2], [-3, -2])


@pytest.mark.parametrize(("back_s", "logs"), [(0.9, 1), (1.1, 2)])
def test_threads_that_overtake_each_other_are_no_clock_that_is_put_back(
    recorded: Recorded, tmp_path: Path, back_s: float, logs: int
) -> None:
    for step_s in (0.0, 1.0, -back_s, 0.1):
        recorded.clock.stamp += round(step_s * SECOND)
        recorded.diagnose()
    recorded.log.close()
    assert len(list(tmp_path.iterdir())) == logs


def test_decisions_of_a_clock_that_is_ahead_are_of_when_they_came(recorded: Recorded, tmp_path: Path) -> None:
    """They were of ten seconds later, and `check` found all well."""
    for _ in range(3):
        recorded.decide(10)
        recorded.diagnose()
        recorded.clock.stamp += SECOND
    recorded.log.close()
    assert recorded.said == []
    assert times(tmp_path / "arm.mcap") == [0, 0, 1, 1, 2, 2]


def test_what_is_taken_away_is_all_of_it(recorded: Recorded, tmp_path: Path) -> None:
    recorded.decide(0)
    recorded.clock.stamp -= 5 * SECOND
    recorded.diagnose()
    assert recorded.log.topics == (SEPARATION, DIAGNOSTICS)
    recorded.log.discard()
    assert list(tmp_path.iterdir()) == []


def test_what_came_before_a_clock_was_put_back_begins_no_third_recording(tmp_path: Path) -> None:
    """Where a disk stood still it may be written after what came since."""
    said: list[str] = []
    arrivals, put_back = Arrivals(), PutBackClock(tmp_path / "arm.mcap", said.append)
    before, since = arrivals.at(START), arrivals.at(START - 5 * SECOND)
    begun = [put_back.beside(came) is not None for came in (before, since, before, since)]
    assert (begun, len(said)) == ([False, True, False, False], 1)
