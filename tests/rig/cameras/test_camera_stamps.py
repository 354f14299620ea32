"""Stamps of cameras: never ahead of now, always rising, following a clock that was set."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from twin_node.rig.cameras import CaptureStamps


class Clock:
    def __init__(self) -> None:
        self.now = 1_000_000_000_000

    def __call__(self) -> int:
        return self.now


@given(st.lists(st.tuples(st.integers(0, 50_000_000), st.integers(-5_000_000, 40_000_000)), min_size=1, max_size=40))
def test_stamps_rise_and_stay_behind_now(steps: list[tuple[int, int]]) -> None:
    clock = Clock()
    stamps, told = CaptureStamps(wall=clock, steady=clock), []
    for passed, ahead in steps:
        clock.now += passed + len(steps)  # time passes: a clamped stamp has room to rise by a nanosecond
        told.append(stamps.of_steady(clock.now - 20_000_000 + ahead))
        assert told[-1] <= max(clock.now, told[-2] + 1 if len(told) > 1 else 0)
    assert told == sorted(set(told))


def test_a_good_stamp_is_left_alone_and_a_bad_one_counted() -> None:
    clock = Clock()
    stamps = CaptureStamps(wall=clock, steady=clock)
    assert stamps.of_steady(clock.now - 7) == clock.now - 7
    assert stamps.clamped == 0
    clock.now += 100
    assert stamps.of_steady(clock.now + 50) == clock.now
    assert stamps.clamped == 1


def test_a_clock_that_was_set_back_is_followed() -> None:
    clock = Clock()
    stamps = CaptureStamps(wall=clock, steady=lambda: 0)
    stamps.of_arrival(0)
    clock.now -= 1_000_000_000
    assert stamps.of_arrival(0) == clock.now
