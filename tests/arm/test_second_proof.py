"""The second proof: what was seen, and how far it can have come since, beside what is forecast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from obstacle_sets import MS, NOW, Thing
from turning_arm import REACTION_S, SEEN, TURNING, beside_the_tool, decided, decided_since

from twin_node.arm import ArmCollisionChecker, stopping_table
from twin_node.arm.separation import Reaches
from twin_node.scene import ObstacleKind


def test_what_was_seen_is_a_second_proof(ur5e_checker: ArmCollisionChecker) -> None:
    wild = beside_the_tool(ur5e_checker, -0.1, size=(0.6,) * 3, valid_ms=(0, 200))
    assert decided_since(ur5e_checker, wild).speed_fraction == 0.0
    shares = []
    for left_m in (0.25, 0.6, 0.8, 1.5):
        seen = beside_the_tool(ur5e_checker, left_m, valid_ms=SEEN)
        both = decided_since(ur5e_checker, wild, seen)
        alone = decided_since(ur5e_checker, seen)
        assert both.speed_fraction == pytest.approx(alone.speed_fraction)
        shares.append(both.speed_fraction)
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.parametrize(("kind", "share"), [(ObstacleKind.UNKNOWN, 1.0), (ObstacleKind.MOVING, 0.0)])
def test_where_it_was_before_the_forecast_begins_is_asked_of_what_moves_alone(
    ur5e_checker: ArmCollisionChecker, kind: ObstacleKind, share: float
) -> None:
    later = beside_the_tool(ur5e_checker, 0.3, kind=kind, valid_ms=(200, 400))
    assert decided(ur5e_checker, later, velocity=0.1 * TURNING).speed_fraction == share


def test_a_fast_thing_proves_less(ur5e_checker: ArmCollisionChecker) -> None:
    wild = beside_the_tool(ur5e_checker, -0.1, size=(0.6,) * 3)
    seen = beside_the_tool(ur5e_checker, 1.0, valid_ms=SEEN)
    walking = decided_since(ur5e_checker, wild, seen)
    thrown = decided_since(ur5e_checker, wild, replace(seen, velocity=(0.0, -5.0, 0.0)))
    assert thrown.speed_fraction < walking.speed_fraction


def test_a_close_forecast_that_is_clear_is_proof_enough(ur5e_checker: ArmCollisionChecker) -> None:
    leaves = beside_the_tool(ur5e_checker, 0.8)
    was_near = beside_the_tool(ur5e_checker, 0.2, valid_ms=SEEN)
    assert decided_since(ur5e_checker, was_near).speed_fraction == 0.0
    assert decided_since(ur5e_checker, leaves, was_near).speed_fraction == 1.0


def test_the_second_proof_holds_for_an_arm_that_leaves_until_it_stands(ur5e_checker: ArmCollisionChecker) -> None:
    """It was asked where somebody can be by now: who came from aside was forecast in the arm, which then went on."""
    overtakes = beside_the_tool(ur5e_checker, 0.06)
    touch_m, stop_s = 0.035, stopping_table("ur5e").stop(TURNING).duration_s

    def share(left_m: float) -> float:
        seen = beside_the_tool(ur5e_checker, left_m, valid_ms=SEEN)
        return decided_since(ur5e_checker, overtakes, seen, velocity=-TURNING).speed_fraction

    at_rest_m = 1.6 * (0.15 + REACTION_S) + touch_m
    assert share(at_rest_m - 0.03) == 0.0
    assert 0.0 < share(at_rest_m + 0.8 * stop_s) < 1.0
    assert share(at_rest_m + 1.6 * stop_s + 0.1) == 1.0


def test_an_arm_leaves_whom_nobody_forecast_only_if_he_cannot_overtake_it(ur5e_checker: ArmCollisionChecker) -> None:
    """He was taken to stay where he was seen: of present obstacles alone a hand came from behind into a moving arm."""
    at_rest_m = 1.6 * (0.15 + REACTION_S) + 0.035
    at_full_speed_m = at_rest_m + 1.6 * stopping_table("ur5e").stop(TURNING).duration_s
    behind = [beside_the_tool(ur5e_checker, -left_m, valid_ms=SEEN) for left_m in np.arange(0.3, 1.0, 0.05)]
    found = [decided_since(ur5e_checker, seen) for seen in behind]
    assert {one.speed_fraction for one in found if one.distance < at_rest_m} == {0.0}
    assert {one.speed_fraction for one in found if one.distance > at_full_speed_m} == {1.0}
    between = [one.speed_fraction for one in found if at_rest_m < one.distance < at_full_speed_m]
    assert len(between) > 1 and between == sorted(between)
    assert between[0] > 0.0 and between[-1] < 1.0


def test_who_overtakes_an_arm_and_turns_in_before_it_is_not_behind_it(ur5e_checker: ArmCollisionChecker) -> None:
    """The arm leaves where a hand was seen, so that proved enough: it went on at full speed into who was forecast."""
    turns_in, goes_away = beside_the_tool(ur5e_checker, 0.1), beside_the_tool(ur5e_checker, 1.5)
    was_behind = beside_the_tool(ur5e_checker, -0.5, valid_ms=SEEN)
    assert decided_since(ur5e_checker, goes_away, was_behind).speed_fraction == 1.0
    both = decided_since(ur5e_checker, turns_in, was_behind)
    assert (both.speed_fraction, both.reason) == (0.0, "stopped for MOVING")
    was_far_behind = beside_the_tool(ur5e_checker, -1.5, valid_ms=SEEN)
    assert decided_since(ur5e_checker, turns_in, was_far_behind).speed_fraction == 1.0


@given(
    left_m=st.floats(0.0, 1.5),
    size_m=st.floats(0.05, 0.8),
    forecast_m=st.floats(-0.3, 1.0),
    speed=st.floats(0.0, 5.0),
    delay_s=st.floats(-0.5, 0.3),
)
@settings(max_examples=30, deadline=None)
def test_a_second_proof_never_slows(
    ur5e_checker: ArmCollisionChecker, left_m: float, size_m: float, forecast_m: float, speed: float, delay_s: float
) -> None:
    forecast = beside_the_tool(ur5e_checker, forecast_m, size=(size_m,) * 3)
    seen = beside_the_tool(ur5e_checker, left_m, valid_ms=SEEN)
    alone = decided_since(ur5e_checker, forecast)
    by_law = decided_since(ur5e_checker, forecast, seen)
    assert by_law.speed_fraction >= alone.speed_fraction - 1e-9
    told = decided_since(ur5e_checker, forecast, replace(seen, reach=(speed, delay_s)))
    assert told.speed_fraction >= by_law.speed_fraction - 1e-9


def wild_forecast(checker: ArmCollisionChecker, *valid_ms: int) -> Thing:
    """One that proves nothing."""
    return beside_the_tool(checker, -0.1, size=(0.6,) * 3, valid_ms=valid_ms)


def test_who_gets_nowhere_by_the_forecast_does_not_hold_an_arm_that_leaves(ur5e_checker: ArmCollisionChecker) -> None:
    wild = wild_forecast(ur5e_checker, -50, 400)
    shares = []
    for reach_m_s in (1.6, 0.1):
        seen = beside_the_tool(ur5e_checker, 0.12, valid_ms=SEEN, reach=(reach_m_s, 0.0))
        shares.append(decided_since(ur5e_checker, wild, seen, velocity=-TURNING).speed_fraction)
    assert shares == [0.0, 1.0]


def test_what_was_seen_gets_no_farther_than_its_forecast_says(ur5e_checker: ArmCollisionChecker) -> None:
    wild = wild_forecast(ur5e_checker, -50, 400)
    seen = beside_the_tool(ur5e_checker, 0.47, valid_ms=SEEN)
    found = {
        reach: decided_since(ur5e_checker, wild, replace(seen, reach=reach))
        for reach in ((0.0, 0.0), (9.0, 0.0), (0.9, 0.0), (0.9, 0.045), (0.5, 0.0))
    }
    shares = [one.speed_fraction for one in found.values()]
    assert shares[0] == shares[1] < shares[2] < shares[3] < shares[4]
    slow = found[0.9, 0.045]
    stop = stopping_table("ur5e").stop(TURNING)  # terms are those of the whole speed
    assert slow.term_human == pytest.approx(0.9 * (0.15 + REACTION_S + stop.duration_s - 0.045), abs=1e-6)


def test_after_its_forecast_what_was_seen_goes_on_as_the_law_has_it(ur5e_checker: ArmCollisionChecker) -> None:
    wild = wild_forecast(ur5e_checker, -50, 100)
    seen = beside_the_tool(ur5e_checker, 0.4, valid_ms=SEEN, reach=(0.5, 0.0))
    found = decided_since(ur5e_checker, wild, seen)
    beyond_s = REACTION_S + stopping_table("ur5e").stop(TURNING).duration_s - 0.1
    assert found.term_human == pytest.approx(0.5 * 0.25 + 1.6 * beyond_s, abs=1e-6)


def test_before_its_forecast_begins_it_may_be_as_far_as_then() -> None:
    """A line through what is reached from the first horizon on says nothing of the time before."""
    told = Reaches(
        np.array([1.0, 0.0]), np.array([0.05, 0.0]), evidence=NOW, begins=NOW + 100 * MS, ends=NOW + 300 * MS
    )
    for ms, reach_m in ((0, 0.05), (100, 0.05), (200, 0.15), (300, 0.25), (400, 0.25 + 0.16)):
        found = told.until(NOW + ms * MS, np.full(2, 1.6))
        assert found[0] == pytest.approx(reach_m)
        assert found[1] == np.inf  # nobody says it


def test_what_moves_far_away_proves_nothing_of_what_stands(ur5e_checker: ArmCollisionChecker) -> None:
    """It passes by sight too: a table under the tool must not pass along with it."""
    away = (beside_the_tool(ur5e_checker, 1.5), beside_the_tool(ur5e_checker, 1.5, valid_ms=SEEN))
    table = beside_the_tool(ur5e_checker, 0.06, kind=ObstacleKind.STATIC)
    assert decided_since(ur5e_checker, *away).speed_fraction == 1.0
    assert decided_since(ur5e_checker, table, *away).speed_fraction == 0.0


def test_nothing_comes_nearer_before_its_delay_is_over() -> None:
    told = Reaches(np.array([1.0]), np.array([0.15]), evidence=NOW, begins=NOW, ends=NOW + 300 * MS)
    assert told.until(NOW + 100 * MS, np.array([1.6]))[0] == 0.0


def test_who_passes_the_arm_before_the_forecast_begins_is_on_the_way_meanwhile(
    ur5e_checker: ArmCollisionChecker,
) -> None:
    """Seen on one side and forecast on the other, a hand counted nowhere between: the arm went on into it."""
    seen = beside_the_tool(ur5e_checker, -0.25, valid_ms=SEEN)
    beyond = beside_the_tool(ur5e_checker, 0.35, valid_ms=(250, 450))
    found = decided_since(ur5e_checker, seen, beyond)
    assert (found.speed_fraction, found.reason) == (0.0, "stopped for MOVING")
    assert found.term_human == pytest.approx(1.6 * 0.25)  # from the first layer: nearer to the truth than from before
    assert found.required == pytest.approx(found.term_human + 0.035)
    stays = replace(seen, reach=(0.01, 0.0))
    assert decided_since(ur5e_checker, stays, beyond).speed_fraction > 0.5
    arrives = beside_the_tool(ur5e_checker, 0.7, valid_ms=(250, 450))
    assert decided_since(ur5e_checker, seen, arrives).speed_fraction == 1.0  # nobody can come through the arm to there


@pytest.mark.parametrize(("begins_ms", "touches_m", "passes_m"), [(100, 0.12, 0.35), (20, 0.1, 0.2)])
def test_of_who_is_forecast_alone_nobody_knows_where_they_were(
    ur5e_checker: ArmCollisionChecker, begins_ms: int, touches_m: float, passes_m: float
) -> None:
    """The first layer begins in 100 ms: until then who is in it may be 16 cm away; in 20 ms they may be 3 cm."""
    for left_m, share in ((touches_m, 0.0), (passes_m, 1.0)):
        somebody = beside_the_tool(ur5e_checker, left_m, valid_ms=(begins_ms, 300))
        assert decided_since(ur5e_checker, somebody, velocity=-TURNING).speed_fraction == share
