"""Clocks: time as `/clock` tells it, between its messages, when it stands, and when it jumps."""

from __future__ import annotations

import threading

import pytest

from twin_node.runtime import clock as clock_module
from twin_node.runtime.clock import FollowedClock, PacedClock, SystemClock, ahead_of_monotonic

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


def test_a_log_runs_at_its_rate_once_it_is_started(steady: Steady) -> None:
    clock = PacedClock(1_000 * MS, 4.0)
    steady.now += 30 * MS
    assert clock.now() == 1_000 * MS
    clock.start()
    steady.now += 30 * MS
    assert clock.now() == 1_120 * MS
    assert clock.seconds_until(1_520 * MS) == pytest.approx(0.1)


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


def test_a_message_that_was_held_up_does_not_make_time_run_ahead(steady: Steady) -> None:
    """The pace between it and the next seems ten times the log's: time was a tenth of a second ahead, and all that
    is stamped seemed older by that."""
    clock = FollowedClock()
    for k in range(20):
        clock.set((1_000 + 10 * k) * MS)
        steady.now += 10 * MS
    steady.now += 9 * MS
    clock.set(1_200 * MS)
    steady.now += 1 * MS
    clock.set(1_210 * MS)
    steady.now += 8 * MS
    assert 1_218 * MS <= clock.now() <= 1_221 * MS


def test_a_pace_is_learnt_anew_where_the_log_goes_on_elsewhere(steady: Steady) -> None:
    clock = FollowedClock()
    for start in (1_000, 900_000):
        for k in range(3):
            clock.set((start + 10 * k) * MS)
            steady.now += 10 * MS
        assert clock.now() == (start + 30) * MS


def test_a_pace_that_changes_is_followed(steady: Steady) -> None:
    clock, told = FollowedClock(), 1_000 * MS
    for step in (10, 5):
        for _ in range(FollowedClock.KEPT):
            told += step * MS
            clock.set(told)
            steady.now += 10 * MS
        assert clock.now() == told + step * MS


def test_a_paused_log_that_tells_the_same_time_again_does_not_begin_again(steady: Steady) -> None:
    jumps = []
    clock = FollowedClock(lambda: jumps.append(clock.now()))
    for _ in range(FollowedClock.KEPT):
        clock.set(9_000 * MS)
        steady.now += 10 * MS
    assert (clock.now(), jumps) == (9_000 * MS, [])


def test_a_log_that_begins_again_is_told(steady: Steady) -> None:
    jumps = []
    clock = FollowedClock(lambda: jumps.append(clock.now()))
    clock.set(9_000 * MS)
    clock.set(1_000 * MS)
    assert jumps == [1_000 * MS]
    assert clock.now() == 1_000 * MS


def test_a_log_that_begins_again_while_somebody_asks_for_the_time(
    steady: Steady, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who asked put time forward again to where the log had been, and there it stood for all nodes of the process."""
    clock, jumps = FollowedClock(), list[threading.Thread]()
    clock.set(9_000 * MS)

    def interrupted(*values: int) -> int:
        if not jumps:
            jumps.append(threading.Thread(target=clock.set, args=(1_000 * MS,)))
            jumps[0].start()
            jumps[0].join(0.1)
        return max(values)

    monkeypatch.setattr(clock_module, "max", interrupted, raising=False)
    clock.now()
    jumps[0].join()
    assert clock.now() == 1_000 * MS


class Wall:
    """The computer's time of day, and how long a look at it takes."""

    def __init__(self, steady: Steady) -> None:
        self._steady = steady
        self.ahead = 1_700_000_000_000 * MS
        self.look = 0

    def time_ns(self) -> int:
        self._steady.now += self.look
        return self._steady.now + self.ahead


@pytest.fixture
def wall(steady: Steady, monkeypatch: pytest.MonkeyPatch) -> Wall:
    wall = Wall(steady)
    monkeypatch.setattr(clock_module.time, "time_ns", wall.time_ns)
    return wall


@pytest.mark.parametrize("back", [200, 3_600_000])
def test_a_computers_clock_that_is_put_back_is_told_once(steady: Steady, wall: Wall, back: int) -> None:
    jumps: list[int] = []
    clock = SystemClock(lambda: jumps.append(steady.now))
    for _ in range(3):
        steady.now += 20 * MS
        assert clock.now() == wall.time_ns()
    wall.ahead -= back * MS
    assert clock.now() == wall.time_ns()
    assert jumps == [steady.now]
    steady.now += 20 * MS
    clock.now()
    assert len(jumps) == 1


def test_a_clock_that_is_put_on_or_slowed_and_a_look_that_is_held_up_are_no_jumps(steady: Steady, wall: Wall) -> None:
    jumps: list[int] = []
    clock = SystemClock(lambda: jumps.append(steady.now))
    clock.now()
    wall.ahead += 3_600_000 * MS
    clock.now()
    for _ in range(300):
        steady.now += 20 * MS
        wall.ahead -= MS  # chrony leads a clock back so slowly that nothing notices
        clock.now()
    wall.look = 5_000 * MS
    clock.now()
    wall.look = 0
    clock.now()
    assert jumps == []


def test_how_far_a_clock_is_ahead_is_told_by_a_look_that_was_not_held_up(steady: Steady) -> None:
    """Between two looks of a busy machine 50 ms passed: an arm's joints were stamped before those sent earlier."""
    held_up = [50 * MS, 0, 20 * MS]

    class Wall:
        def now(self) -> int:
            now = steady.now + 7 * MS
            steady.now += held_up.pop(0)
            return now

    assert ahead_of_monotonic(Wall()) == 7 * MS
