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


def test_too_little_to_judge_by_tells_nothing() -> None:
    few = Held(seen=FEWEST - 1, covered=0, measured=FEWEST - 1, agreed=0)
    assert Watch().after(few).warnings == ()


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
