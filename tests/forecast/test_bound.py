"""The bound reaches its target, grows after surprises and shrinks again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.forecast.bound import (
    CUES,
    LARGEST_RADIUS,
    LEAST,
    Bound,
    BoundParameters,
    CueLengths,
    Expected,
    cues,
)
from twin_node.forecast.measured import most_astray

PERIOD = 1 / 30
HORIZON = 0.2


def like(scale: np.ndarray) -> np.ndarray:
    """Cues of nodes whose every length is `scale` [M]."""
    return cues(CueLengths(scale, scale, scale, scale, scale, scale))


def followed(bound: Bound, seconds: float, spread_of_errors: np.ndarray, start: float = 0.0) -> list[np.ndarray]:
    """Lets a bound judge nodes whose errors are half normal with known spreads [M], m; whether each was held."""
    rng = np.random.default_rng(3)
    now, held = like(spread_of_errors), []
    ages = np.ones(len(spread_of_errors))
    for time in start + np.arange(0, seconds, PERIOD):
        radii = bound.radii(bound.expected(now), ages, HORIZON)
        errors = np.abs(rng.normal(0, spread_of_errors))
        held.append(errors <= radii)
        bound.observe(float(time), now, errors, radii, PERIOD)
    return held


def test_coverage_settles_at_the_target_with_radii_in_proportion_to_the_errors() -> None:
    spreads = np.repeat([0.03, 0.3], 20)
    bound = Bound(BoundParameters(coverage=0.95))
    followed(bound, 4.0, spreads)
    held = np.array(followed(bound, 8.0, spreads, 4.0))
    assert 0.93 < held.mean() < 0.97
    radii = bound.radii(bound.expected(like(spreads)), np.ones(40), HORIZON)
    assert radii[-1] > 3 * radii[0]
    assert 1.5 < radii[-1] / 0.3 < 2.6  # 95 % of a half normal lie within 1.96 of its spread


def test_small_errors_make_small_bounds() -> None:
    bound = Bound()
    first = bound.radii(bound.expected(like(np.full(5, 0.01))), np.ones(5), HORIZON)
    followed(bound, 4.0, np.full(5, 0.002))
    assert np.all(bound.radii(bound.expected(like(np.full(5, 0.01))), np.ones(5), HORIZON) < 0.1 * first)


def test_surprises_widen_the_bound_step_by_step_and_are_forgotten() -> None:
    bound = Bound()
    calm = np.full(5, 0.01)
    followed(bound, 4.0, calm)

    def radius() -> float:
        return float(bound.radii(bound.expected(like(calm)), np.ones(5), HORIZON)[0])

    before = radius()
    bound.observe(4.0, like(calm), np.full(5, 0.2), np.full(5, before), PERIOD)
    assert 1.05 * before < radius() < 2 * before
    for step in range(1, 15):
        bound.observe(4 + step * PERIOD, like(calm), np.full(5, 0.2), np.full(5, radius()), PERIOD)
    assert radius() > 3 * before
    followed(bound, 12.0, calm, 5.0)
    assert radius() < 1.5 * before


def test_one_good_set_is_no_record_and_a_few_seconds_are() -> None:
    """Of 2 s of steady errors the bound holds little more than these; of the first of them it hardly narrows."""
    bound, now, errors = Bound(), like(np.full(40, 0.05)), np.full(40, 0.01)
    first = bound.quantile
    bound.observe(0.0, now, errors, bound.radii(bound.expected(now), np.ones(40), HORIZON), PERIOD)
    assert 0.7 * first < bound.quantile < 0.95 * first
    for step in range(1, 90):
        bound.observe(step * PERIOD, now, errors, bound.radii(bound.expected(now), np.ones(40), HORIZON), PERIOD)
    assert np.all(bound.radii(bound.expected(now), np.ones(40), HORIZON) < 0.02)


def test_who_erred_much_long_ago_is_expected_to_err_as_of_late() -> None:
    bound, spreads = Bound(), np.repeat([0.02, 0.3], 20)
    now, found = like(spreads), []
    for time in np.arange(0, 12, PERIOD):
        errors = np.repeat([0.01, 0.2] if time < 4 else [0.2, 0.01], 20)
        bound.observe(float(time), now, errors, np.ones(40), PERIOD)
        found.append(bound.scales(now))
    assert found[100][0] < found[100][-1]
    assert found[-1][0] > found[-1][-1]


def test_a_gesture_or_two_later_the_bound_has_forgotten_what_erred_more() -> None:
    """Of nine in ten errors that are to be held, the larger ones of before are a tenth after 4 to 5 s."""
    bound, now, radii = Bound(BoundParameters(coverage=0.9)), like(np.full(20, 0.1)), []
    for time in np.arange(0, 11.5, PERIOD):
        radii.append(bound.radii(bound.expected(now), np.ones(20), HORIZON)[0])
        bound.observe(float(time), now, np.full(20, 0.1 if time < 6 else 0.01), np.full(20, radii[-1]), PERIOD)
    assert radii[round(9 / PERIOD)] >= 0.1
    assert radii[round(11 / PERIOD)] < 0.02


def test_what_was_supposed_of_the_quantile_and_what_came_have_an_equal_say_after_a_third_of_a_second() -> None:
    """Of errors as large as the scale takes them for, so that it is the quantile alone that learns."""
    bound, length = Bound(), 0.05
    now, first = like(np.full(40, length)), bound.quantile
    halfway, found = np.sqrt(first * length / bound.scales(now)[0]), {}
    for step in range(15):
        bound.observe(step * PERIOD, now, np.full(40, length), np.ones(40), PERIOD)
        found[step + 1] = bound.quantile
    assert found[round(0.25 / PERIOD)] > 1.05 * halfway
    assert found[round(0.45 / PERIOD)] < 0.95 * halfway


@pytest.mark.parametrize(("times", "share"), [(2.0, 0.75), (0.5, 0.25)])
def test_one_set_moves_the_expected_errors_most_of_the_way_up_and_a_quarter_of_the_way_down(
    times: float, share: float
) -> None:
    """Of nodes that go so far that no cue but the constant tells anything."""
    bound, now, error = Bound(), cues(CueLengths(*np.full((6, 30), 1 - LEAST))), 1.0
    bound.observe(0.0, now, np.full(30, times * error - LEAST), np.ones(30), PERIOD)
    moved = np.log(bound.scales(now)[0] / error) / np.log(times)
    assert moved == pytest.approx(share, abs=0.05)


def test_lengths_below_a_voxel_or_two_hardly_tell_errors_apart_and_those_of_a_limb_do() -> None:
    nothing, finger, hand, forearm = Bound().scales(like(np.array([0.0, 0.01, 0.1, 0.25])))
    assert nothing < finger < 1.25 * nothing
    assert 1.8 < forearm / hand < 2.2


def test_errors_that_are_just_held_are_not_missed() -> None:
    assert quantile_after(1.0) == quantile_after(1.05)


def quantile_after(share: float) -> float:
    """Of 2 s of errors whose radii were this share of them."""
    rng, bound = np.random.default_rng(3), Bound(BoundParameters(coverage=0.9))
    for step in range(60):
        errors = rng.uniform(0.01, 0.1, 20)
        bound.observe(step * PERIOD, like(np.full(20, 0.05)), errors, share * errors, PERIOD)
    return float(bound.quantile)


def test_misses_ask_for_a_larger_quantile_of_the_same_errors() -> None:
    """Adaptive conformal inference: who misses more than he may aims at missing less from then on."""
    assert quantile_after(0.95) > 1.02 * quantile_after(1.05)


def test_forecasts_of_before_something_new_began_tell_nothing_of_errors_to_come() -> None:
    """However wild those were."""
    spreads, known = np.full(20, 0.01), np.arange(20) >= 10
    found = []
    for grown, wild in ((known, 0.5), (known, 5.0), (None, 0.5)):
        bound = Bound()
        followed(bound, 4.0, spreads)
        bound.observe(4.0, like(spreads), np.where(known, 0.005, wild), np.full(20, 0.05), PERIOD, grown)
        found.append(bound.radii(bound.expected(like(spreads)), np.ones(20), HORIZON)[0])
    assert found[0] == found[1] < found[2]


def test_without_a_record_the_reachable_set_stands_in() -> None:
    bound = Bound(BoundParameters(acceleration=8.0))
    followed(bound, 4.0, np.full(5, 0.002))
    young, old = bound.radii(bound.expected(like(np.full(2, 0.01))), np.array([0.1, 1.0]), HORIZON)
    assert young >= 0.5 * 8.0 * HORIZON**2
    assert old < young


@given(st.floats(0, 12), st.floats(0, 0.2), st.floats(0, 0.3))
def test_the_reach_is_as_far_as_the_acceleration_leads_from_a_velocity_of_before(
    acceleration: float, horizon_s: float, stale_s: float
) -> None:
    """Of something that has gained speed all the while since its velocity was told, and goes on to."""

    def at(time: float) -> float:
        return acceleration * time**2 / 2

    led = at(0.0) - acceleration * stale_s * horizon_s
    reach = Bound(BoundParameters(acceleration=acceleration)).reachable(horizon_s, stale_s)
    assert reach == pytest.approx(at(horizon_s) - led, abs=1e-12)


def test_without_a_record_a_bound_holds_where_an_old_velocity_and_the_experts_may_be_wrong_at_once() -> None:
    bound, apart, stale_s = Bound(), np.array([0.0, 0.05]), 0.1
    expected = Expected(np.full(2, 0.01), apart)
    radii = bound.radii(expected, np.zeros(2), HORIZON, stale_s=stale_s)
    np.testing.assert_allclose(radii, bound.reachable(HORIZON, stale_s) + apart)
    assert np.all(radii > bound.radii(expected, np.zeros(2), HORIZON))


def test_the_images_factor_widens_and_narrows_what_was_learnt_but_takes_nothing_from_the_reach() -> None:
    bound, ages = Bound(), np.array([HORIZON, 0.0])
    expected = Expected(np.full(2, 0.04), np.zeros(2))
    narrow, plain, wide = (bound.radii(expected, ages, HORIZON, factor) for factor in (0.5, 1.0, 3.0))
    assert narrow[0] == pytest.approx(0.5 * plain[0])
    assert wide[0] == pytest.approx(3.0 * plain[0])
    assert narrow[1] == plain[1] == pytest.approx(bound.reachable(HORIZON))
    assert wide[1] == wide[0] > plain[1]


def learnt(errors: np.ndarray, period: float) -> tuple[float, float]:
    """Expected error and quantile after errors [T, n], each row of which lasts for `PERIOD`, looked at so often."""
    bound, now = Bound(), like(np.full(errors.shape[1], 0.1))
    for step, row in enumerate(np.repeat(errors, round(PERIOD / period), axis=0)):
        bound.observe(step * period, now, row, np.ones(len(row)), period)
    return float(bound.scales(now)[0]), bound.quantile


SEVERAL = np.geomspace(0.005, 0.2, 10)
"""Errors of as many nodes, m."""


@pytest.mark.parametrize("copies", [2, 6])
def test_a_body_of_more_nodes_errs_no_more_often(copies: int) -> None:
    """Neighbouring nodes err together: a hundred that do are no hundred surprises."""
    assert learnt(np.repeat(SEVERAL, copies)[None], PERIOD) == pytest.approx(learnt(SEVERAL[None], PERIOD))


@pytest.mark.parametrize("per_period", [2, 4])
@pytest.mark.parametrize("shares", [[0.01], [1.0] * 6, [1.0] * 15 + [0.1] * 60])
def test_how_often_errors_are_looked_at_tells_nothing_of_them(per_period: int, shares: list[float]) -> None:
    """Cameras of 60 and 120 Hz learn and forget as fast as those of 30 Hz, at once, later, and after a change."""
    errors = np.outer(shares, SEVERAL)
    assert learnt(errors, PERIOD / per_period) == pytest.approx(learnt(errors, PERIOD), rel=0.03)


def test_of_a_large_body_no_part_is_left_out_of_the_record() -> None:
    """Only some of its nodes are entered: where these were its first ones, a hand that came last was never learnt."""
    bound, now = Bound(), like(np.full(200, 0.05))
    errors = np.repeat([0.005, 0.1], 100)
    for step in range(90):
        bound.observe(step * PERIOD, now, errors, np.ones(200), PERIOD)
    assert bound.radii(bound.expected(now), np.ones(200), HORIZON)[-1] >= 0.1


def test_how_far_experts_are_apart_is_what_the_cues_say_whatever_else_they_do() -> None:
    apart, other = np.array([0.0, 0.04, 0.3]), np.array([1.0, 0.2, 0.0])
    now = cues(CueLengths(apart, other, other, other, other, other))
    np.testing.assert_allclose(Bound().expected(now).spread, apart, atol=1e-12)


def test_however_long_nothing_is_missed_no_more_may_be_missed_than_five_times_the_share_aimed_at() -> None:
    """So many do miss then, until the level has come down again: a tenth must still be held by nine of ten."""
    rng, bound = np.random.default_rng(3), Bound(BoundParameters(coverage=0.98, correction=10.0))
    errors = np.zeros(0)
    for step in range(120):
        errors = rng.uniform(0.0, 0.2, 40)
        bound.observe(step * PERIOD, like(np.full(40, 0.1)), errors, np.ones(40), PERIOD)
    radii = bound.radii(bound.expected(like(np.full(40, 0.1))), np.ones(40), HORIZON)
    assert 0.85 < np.mean(rng.uniform(0.0, 0.2, 2000) < radii[0]) < 0.97


def test_no_radius_exceeds_the_largest() -> None:
    bound = Bound()
    followed(bound, 2.0, np.full(5, 5.0))
    assert np.all(bound.radii(bound.expected(like(np.full(5, 5.0))), np.ones(5), HORIZON) <= LARGEST_RADIUS)


def test_the_largest_radius_holds_how_far_people_get_astray_at_3_metres_a_second_and_not_at_4() -> None:
    slower, faster = most_astray(np.array([3.0, 4.0]), np.array([HORIZON]))[0]
    assert slower <= LARGEST_RADIUS < faster


def test_nothing_to_judge_changes_nothing() -> None:
    bound = Bound()
    followed(bound, 2.0, np.full(5, 0.05))
    before = bound.radii(bound.expected(like(np.full(5, 0.05))), np.ones(5), HORIZON)
    bound.observe(2.0, np.zeros((0, CUES)), np.zeros(0), np.zeros(0), PERIOD)
    assert np.array_equal(bound.radii(bound.expected(like(np.full(5, 0.05))), np.ones(5), HORIZON), before)
