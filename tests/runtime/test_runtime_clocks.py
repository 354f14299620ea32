"""Clocks: time as `/clock` tells it, between its messages, when it stands, and when it jumps."""

from __future__ import annotations

import pytest

from twin_node.runtime import clock as clock_module
from twin_node.runtime.clock import FollowedClock

MS = 1_000_000


class Steady:
    def __init__(self) -> None:
        self.now = 50_000 * MS

    def monotonic_ns(self) -> int:
        return self.now


@pytest.fixture
def steady(monkeypatch: pytest.MonkeyPatch) -> Steady:
    steady = Steady()
    monkeypatch.setattr(clock_module.time, "monotonic_ns", steady.monotonic_ns)
    return steady


def test_time_goes_on_at_the_pace_of_the_log_and_stands_with_it(steady: Steady) -> None:
    clock = FollowedClock()
    assert clock.now() == 0
    clock.set(1_000 * MS)
    steady.now += 10 * MS
    clock.set(1_005 * MS)  # half the pace of the wall
    steady.now += 4 * MS
    assert clock.now() == 1_007 * MS
    steady.now += 10_000 * MS
    assert clock.now() == 1_105 * MS  # nobody has told more: it stands
    clock.set(1_006 * MS)
    assert clock.now() == 1_105 * MS  # and does not go back for a message that is late


def test_a_log_that_begins_again_is_told(steady: Steady) -> None:
    jumps = []
    clock = FollowedClock(lambda: jumps.append(clock.now()))
    clock.set(9_000 * MS)
    clock.set(1_000 * MS)
    assert jumps == [1_000 * MS]
    assert clock.now() == 1_000 * MS
