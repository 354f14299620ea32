"""Pauses are told from the usual pace, slow ones with sets missing too."""

from __future__ import annotations

import pytest
from forecast_worlds import GRID, state_of

from twin_node.forecast import Forecaster, ForecastError
from twin_node.forecast.pace import Pace


def pauses(steps_s: list[float]) -> list[bool]:
    """Of stamps so many seconds apart, from 0 on."""
    pace, stamp = Pace(), 0
    told = [pace.pauses_before(stamp)]
    for step_s in steps_s:
        stamp += round(step_s * 1e9)
        told.append(pace.pauses_before(stamp))
    return told


@pytest.mark.parametrize(("rate", "missing"), [(30, 5), (15, 2), (10, 2), (5, 1)])
def test_a_few_sets_that_are_missing_make_no_pause(rate: int, missing: int) -> None:
    often = [[1 / rate] * 2, [(1 + missing) / rate], [1.02 / rate] * 2] * 6
    assert not any(pauses([step for steps in often for step in steps]))


@pytest.mark.parametrize(("rate", "pause_s"), [(30, 0.27), (15, 0.3), (10, 0.4), (5, 0.6), (4, 0.6), (30, 1e6)])
def test_a_pause_is_one_at_every_pace(rate: int, pause_s: float) -> None:
    told = pauses([1 / rate] * 20 + [pause_s, 1 / rate])
    assert told[-2:] == [True, False]
    assert not any(told[:-2])


def test_one_pause_makes_the_next_no_more_usual() -> None:
    assert pauses([1 / 30] * 20 + [0.4, 1 / 30, 0.4])[-3:] == [True, False, True]


def test_a_pace_is_usual_from_its_second_step_on() -> None:
    assert pauses([0.3] * 4) == [False, True, False, False, False]


def test_a_state_older_than_the_last_is_refused_and_changes_nothing() -> None:
    """A log that begins again would go on with what was known of its end, and nobody would be told."""
    forecaster = Forecaster(GRID)
    forecaster.update(state_of(10**9, None), 10**9)
    with pytest.raises(ForecastError, match="state: expected a stamp of 1000000000 ns or later, found 999999999 ns;"):
        forecaster.update(state_of(10**9 - 1, None), 10**9)
    forecaster.update(state_of(10**9, None), 10**9)
