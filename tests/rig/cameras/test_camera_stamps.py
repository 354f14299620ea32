"""Stamps of cameras: never ahead of now, always rising, following a clock that was set."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.rig.cameras import CaptureStamps
from twin_node.rig.cameras.stamps import RESET_NS


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


def test_a_good_stamp_is_left_alone_and_one_ahead_of_now_is_not() -> None:
    clock = Clock()
    stamps = CaptureStamps(wall=clock, steady=clock)
    assert stamps.of_steady(clock.now - 7) == clock.now - 7
    clock.now += 100
    assert stamps.of_steady(clock.now + 50) == clock.now


def test_a_clock_that_was_set_back_is_followed() -> None:
    clock = Clock()
    stamps = CaptureStamps(wall=clock, steady=lambda: 0)
    stamps.of_arrival(0)
    clock.now -= 1_000_000_000
    assert stamps.of_arrival(0) == clock.now


PERIOD, AGE = 33_000_000, 20_000_000


@pytest.mark.parametrize("kind", ["of_steady", "of_arrival"])
@given(step=st.integers(1, RESET_NS))
def test_after_a_small_step_back_images_are_no_instant_apart(kind: str, step: int) -> None:
    """Motion over a nanosecond would be endlessly fast."""
    wall, steady, told, changed = Clock(), Clock(), [], 0
    stamps = CaptureStamps(wall=wall, steady=steady)
    for image in range(60):
        wall.now += PERIOD - step * (image == 10)
        steady.now += PERIOD
        told.append(stamps.of_arrival(AGE) if kind == "of_arrival" else stamps.of_steady(steady.now - AGE))
        assert told[-1] >= wall.now - AGE
        changed += told[-1] != wall.now - AGE
    apart = [after - before for before, after in pairwise(told)]
    assert min(apart) >= PERIOD // 2
    assert max(apart) <= PERIOD
    assert told[-1] == wall.now - AGE
    assert changed <= 2 * step // PERIOD + 1


def test_many_small_steps_back_are_followed_in_the_end() -> None:
    wall, steady = Clock(), Clock()
    stamps = CaptureStamps(wall=wall, steady=steady)
    for _ in range(40):
        wall.now -= PERIOD
        steady.now += PERIOD
        assert 0 <= stamps.of_arrival(0) - wall.now <= RESET_NS
