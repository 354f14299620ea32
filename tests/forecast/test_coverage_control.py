"""The common factor keeps the coverage that images show: it grows after misses and shrinks again."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.forecast.bound import LEAST_FACTOR, MOST_FACTOR, BoundParameters, CoverageControl


def test_the_factor_grows_with_what_the_images_miss_and_is_slow_to_shrink() -> None:
    control = CoverageControl(BoundParameters())
    before = control.factor
    control.observe(0.7, 0.7, before, 0.2)
    surprised = control.factor
    assert surprised > 1.5 * before
    control.observe(1.0, 1.0, before, 0.2)
    assert control.factor > 0.9 * surprised
    for _ in range(60):
        control.observe(1.0, 1.0, control.factor, 0.2)
    assert control.factor < 0.7 * surprised


def test_forecasts_made_before_a_surprise_do_not_raise_the_factor_again_and_again() -> None:
    """What comes due until a horizon after was made in ignorance: the same share missed asks for the same factor."""
    control = CoverageControl(BoundParameters())
    then = control.factor
    control.observe(0.5, 0.5, then, 0.25)
    first = control.factor
    for _ in range(3):
        control.observe(0.5, 0.5, then, 0.25)
    assert control.factor < 1.1 * first
    control.observe(0.5, 0.5, first, 0.25)
    assert control.factor > 1.5 * first


def test_a_forecast_that_was_wide_enough_does_not_keep_the_factor_up() -> None:
    control = CoverageControl(BoundParameters())
    control.observe(0.5, 0.5, control.factor, 0.25)
    wide = control.factor
    for _ in range(40):
        control.observe(1.0, 1.0, wide, 0.25)
    assert control.factor < 0.5 * wide


def test_two_horizons_after_a_surprise_the_factor_has_come_down_most_of_the_way() -> None:
    control = CoverageControl(BoundParameters())
    before = control.factor
    control.observe(0.5, 0.5, before, 0.25)
    surprised = control.factor
    for _ in range(8):
        control.observe(1.0, 1.0, before, 0.25)
    assert 0.3 < (control.factor - before) / (surprised - before) < 0.5


def test_after_a_pause_a_miss_counts_as_one_of_a_horizon() -> None:
    factors = []
    for elapsed in (1.0, 50.0):
        control = CoverageControl(BoundParameters())
        control.observe(0.5, 0.5, control.factor, elapsed)
        factors.append(control.factor)
    assert factors[0] == factors[1]


def test_what_begins_something_new_is_not_made_up_for_by_larger_radii_of_all_else() -> None:
    control = CoverageControl(BoundParameters())
    before = control.factor
    control.observe(0.5, 1.0, before, 0.25)
    control.observe(0.5, None, before, 0.25)
    assert control.factor <= before
    assert np.isclose(control.coverage, 0.5)


@pytest.mark.parametrize("steady", [None, BoundParameters().coverage])
def test_where_nothing_is_missed_a_wide_forecast_of_before_asks_for_nothing(steady: float | None) -> None:
    control = CoverageControl(BoundParameters())
    before = control.factor
    control.observe(0.5, steady, MOST_FACTOR, 0.25)
    assert control.factor <= before


def test_the_factor_finds_the_target_coverage() -> None:
    """Shares drawn from one distribution."""
    rng = np.random.default_rng(0)
    control = CoverageControl(BoundParameters(coverage=0.95))
    inside = []
    for step in range(3000):
        covered = float(np.mean(np.abs(rng.normal(0, 0.04, 50)) < 0.1 * control.factor))
        control.observe(covered, covered, control.factor, 0.2)
        if step > 1000:
            inside.append(covered)
    assert 0.94 < np.mean(inside) < 0.985


def test_the_factor_does_not_shrink_away_while_all_that_is_seen_is_held() -> None:
    """Of sides that no camera sees nobody tells what was missed."""
    control = CoverageControl(BoundParameters())
    for _ in range(3000):
        control.observe(1.0, 1.0, control.factor, 0.2)
    assert np.isclose(control.factor, LEAST_FACTOR)
    assert 0.9 < control.factor / CoverageControl(BoundParameters()).factor < 1


def test_the_factor_grows_no_further_while_nothing_that_is_seen_is_held() -> None:
    """It would take as long to come down again."""
    control = CoverageControl(BoundParameters())
    for _ in range(100):
        control.observe(0.0, 0.0, control.factor, 1.0)
    assert control.factor == MOST_FACTOR
    for _ in range(60):
        control.observe(1.0, 1.0, control.factor, 1.0)
    assert control.factor < 1


def test_coverage_is_not_a_number_before_the_first_truth() -> None:
    control = CoverageControl(BoundParameters())
    assert np.isnan(control.coverage)
    control.observe(0.9, 0.9, 0.5, 1.0)
    control.observe(1.0, 1.0, 0.5, 1.0)
    assert np.isclose(control.coverage, 0.95)


def test_coverage_is_that_of_the_last_120_judged_sets() -> None:
    control, found = CoverageControl(BoundParameters()), []
    for covered in (0.4, *[1.0] * 120):
        control.observe(covered, covered, 0.5, 1.0)
        found.append(control.coverage)
    assert found[-2:] == pytest.approx([119.4 / 120, 1.0], abs=1e-12)
