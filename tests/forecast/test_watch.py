"""The forecaster tells of its own failures: what moves unforeseen, and cameras that contradict each other."""

from __future__ import annotations

import numpy as np
import pytest
from forecast_worlds import GRID, state_of

from twin_node.forecast import Forecaster
from twin_node.forecast.judgement import AGREEMENT_JUDGEMENTS, FEWEST, Held, Watch

FORESEEN = Held(seen=100, covered=95, measured=100, agreed=90)
UNFORESEEN = Held(seen=100, covered=30, measured=100, agreed=90)
AT_ODDS = Held(seen=100, covered=100, measured=100, agreed=40)


def test_what_moves_unforeseen_is_told_until_the_forecast_holds_it_again() -> None:
    watch = Watch().after(FORESEEN)
    assert watch.warnings == ()
    (warning,) = watch.after(UNFORESEEN).warnings
    assert "not foreseen" in warning
    assert watch.after(UNFORESEEN).after(FORESEEN).warnings == ()


@pytest.mark.parametrize(("covered", "is_told"), [(81, False), (79, True)])
def test_what_moves_is_unforeseen_where_a_fifth_of_it_is_outside_the_forecast(covered: int, is_told: bool) -> None:
    held = Held(seen=100, covered=covered)
    watch = Watch().after(held)
    assert watch.unforeseen == pytest.approx(1 - held.share) == pytest.approx(1 - covered / 100)
    assert bool(watch.warnings) == is_told


def test_too_little_to_judge_by_tells_nothing() -> None:
    few = Held(seen=FEWEST - 1, covered=0, measured=FEWEST - 1, agreed=0)
    assert Watch().after(few) == Watch()
    enough = Watch().after(Held(seen=FEWEST, covered=0, measured=FEWEST, agreed=0))
    assert enough.unforeseen == 1 and enough.agreement < 1


def test_cameras_at_odds_after_a_long_time_of_agreement_are_told_of_within_half_a_second() -> None:
    watch, told = Watch(), []
    for _ in range(1000):
        watch = watch.after(FORESEEN)
    for _ in range(10):
        watch = watch.after(AT_ODDS)
        told.append(bool(watch.warnings))
    assert told == [False] * 6 + [True] * 4


def test_cameras_at_odds_are_told_once_they_have_been_for_a_while() -> None:
    watch = Watch().after(AT_ODDS)
    assert watch.warnings == ()
    for _ in range(3 * AGREEMENT_JUDGEMENTS):
        watch = watch.after(AT_ODDS)
    assert watch.agreement == pytest.approx(0.4, abs=0.05)
    assert "mirrors" in watch.warnings[0]


def test_cameras_without_depth_cannot_be_at_odds() -> None:
    watch = Watch()
    for _ in range(20):
        watch = watch.after(Held(seen=100, covered=100))
    assert watch.agreement == 1.0


def test_a_forecaster_tells_what_it_has_not_foreseen_and_nothing_of_what_has_moved_from_the_first_set_on() -> None:
    forecaster, told = Forecaster(GRID), []
    for tick in range(26):
        stamp = tick * 33_333_333
        jump = 0.5 if tick >= 18 else 0.0
        ball = np.array([-0.3 + jump, -0.3 + 0.5 * stamp * 1e-9, 0.45])
        forecaster.update(state_of(stamp, ball, with_depth=True), stamp + 33_000_000)
        told.append(any("not foreseen" in warning for warning in forecaster.quality.warnings))
    assert not any(told[:18])
    assert any(told[18:])
