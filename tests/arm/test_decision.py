"""The separation law: each term against arithmetic, and what it must and must not slow for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from obstacle_sets import MS, NOW, Thing, obstacles

from twin_node.arm import (
    ArmCollisionChecker,
    ArmError,
    SeparationParameters,
    UnknownPolicy,
    decide,
    extrapolate,
    stopping_table,
)
from twin_node.arm.separation import Encounter, Motion, Reaches, hazards
from twin_node.robot import forward_kinematics, ur_model
from twin_node.robot.mjcf import write_mjcf
from twin_node.robot.ur import JOINT_NAMES
from twin_node.scene import JointPath, ObstacleKind, ObstacleShape, Separation

READY = np.array([0.0, -1.5, 1.5, -1.5, -1.57, 0.0])
REACTION_S = 0.06
TURNING = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""Joint velocities, rad/s: the arm sweeps to its left."""


def ahead(velocity: np.ndarray, begin: int = NOW) -> JointPath:
    offsets = np.arange(0, 201 * MS, 10 * MS)
    return JointPath(JOINT_NAMES, begin + offsets, READY + velocity * offsets[:, None] * 1e-9)


def beside_the_tool(checker: ArmCollisionChecker, left_m: float, **changes: object) -> Thing:
    """A ball of 10 cm whose surface is `left_m` to the left of the last link's origin."""
    tool = forward_kinematics(checker.model, READY)[-1, :3, 3]
    thing = Thing(tuple(tool + np.array([0.0, left_m + 0.05, 0.0])), size=(0.1,) * 3)
    return replace(thing, **changes)


def decided(checker: ArmCollisionChecker, *things: Thing, velocity: np.ndarray = TURNING, **law: object) -> Separation:
    checker.update(obstacles(*things))
    return decide(checker, ahead(velocity), NOW, REACTION_S, replace(SeparationParameters(), **law))


def test_terms_add_up_to_the_law(ur5e_checker: ArmCollisionChecker) -> None:
    found = decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.28))
    stop = stopping_table("ur5e").stop(TURNING)
    approach = found.term_reaction / REACTION_S
    tool_speed = np.hypot(*forward_kinematics(ur5e_checker.model, READY)[-1, :2, 3])  # at 1 rad/s about the base
    assert approach == pytest.approx(tool_speed, rel=0.25)
    assert found.term_stopping == pytest.approx(approach * stop.travel_s)
    assert found.term_human == 0  # 60 ms and the stop end before the forecast does
    assert found.term_intrusion == 0.2
    assert found.term_uncertainty == 0.005
    parts = found.term_human + found.term_reaction + found.term_stopping + found.term_intrusion + found.term_uncertainty
    assert found.required == pytest.approx(parts)
    assert (found.stamp, found.evidence_stamp, found.obstacle_id) == (NOW, NOW, 100)


def test_beyond_the_forecast_people_walk(ur5e_checker: ArmCollisionChecker) -> None:
    short = beside_the_tool(ur5e_checker, 0.42, valid_ms=(0, 20))
    stop = stopping_table("ur5e").stop(TURNING)
    beyond_s = REACTION_S + stop.duration_s - 0.020
    assert decided(ur5e_checker, short).term_human == pytest.approx(1.6 * beyond_s, abs=1e-6)
    running = replace(short, velocity=(0.0, -3.0, 0.0))
    assert decided(ur5e_checker, running).term_human == pytest.approx(3.0 * beyond_s, abs=1e-6)
    standing = replace(short, kind=ObstacleKind.STATIC, position=beside_the_tool(ur5e_checker, 0.12).position)
    assert decided(ur5e_checker, standing).term_human == 0


def test_a_forecast_that_goes_stale_grows(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.5)))
    stamps = [NOW + age * MS for age in (0, 150, 300, 500)]
    later = [decide(ur5e_checker, ahead(TURNING, stamp), stamp, REACTION_S) for stamp in stamps]
    assert [decision.term_human for decision in later] == sorted(decision.term_human for decision in later)
    assert later[0].speed_fraction == 1.0
    assert later[-1].term_human > 0.5
    assert later[-1].speed_fraction == 0.0


@given(gap=st.floats(0.0, 0.8), closer=st.floats(0.0, 0.3))
@settings(max_examples=30, deadline=None)
def test_closer_is_never_faster(ur5e_checker: ArmCollisionChecker, gap: float, closer: float) -> None:
    near = decided(ur5e_checker, beside_the_tool(ur5e_checker, gap))
    far = decided(ur5e_checker, beside_the_tool(ur5e_checker, gap + closer))
    assert near.speed_fraction <= far.speed_fraction
    assert near.distance <= far.distance + 1e-9


def test_speed_is_the_largest_that_keeps_the_distance(ur5e_checker: ArmCollisionChecker) -> None:
    found = decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.29))
    assert 0.1 < found.speed_fraction < 0.9
    # The same pair at the speed that was granted is just far enough: any faster path is slowed to that speed again.
    slowed = decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.29), velocity=TURNING * found.speed_fraction)
    assert slowed.speed_fraction > 0.97
    faster = decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.29), velocity=TURNING * 2)
    assert faster.speed_fraction * 2 == pytest.approx(found.speed_fraction, rel=0.1)


def test_retreat_is_not_slowed(ur5e_checker: ArmCollisionChecker) -> None:
    close = beside_the_tool(ur5e_checker, 0.12)
    assert decided(ur5e_checker, close).speed_fraction == 0.0
    assert decided(ur5e_checker, close).reason == "stopped for MOVING"
    retreat = decided(ur5e_checker, close, velocity=-TURNING)
    assert retreat.speed_fraction == 1.0
    assert retreat.reason == "not closing in"
    assert retreat.obstacle_id == 100
    assert decided(ur5e_checker, close, velocity=np.zeros(6)).speed_fraction == 1.0


def test_an_arm_that_leaves_stands_for_what_may_touch_it(ur5e_checker: ArmCollisionChecker) -> None:
    for velocity in (-TURNING, 0.05 * -TURNING):
        overtaken = decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.06), velocity=velocity)
        assert overtaken.speed_fraction == 0.0
        assert overtaken.reason == "stopped for MOVING"
        assert decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.1), velocity=velocity).speed_fraction == 1.0
    for kind in (ObstacleKind.STATIC, ObstacleKind.UNKNOWN):  # nothing comes out of the one; an arm has its own shadow
        beside = beside_the_tool(ur5e_checker, 0.06, kind=kind)
        assert decided(ur5e_checker, beside, velocity=-TURNING).speed_fraction == 1.0


SEEN = (-150, -150)
"""Validity of what was seen 150 ms ago, ms."""


def decided_since(checker: ArmCollisionChecker, *things: Thing, velocity: np.ndarray = TURNING) -> Separation:
    """As `decided`, on evidence of 150 ms ago."""
    checker.update(obstacles(*things, stamp=NOW - 150 * MS))
    return decide(checker, ahead(velocity), NOW, REACTION_S)


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


def test_the_second_proof_holds_for_an_arm_that_leaves(ur5e_checker: ArmCollisionChecker) -> None:
    overtakes = beside_the_tool(ur5e_checker, 0.06)
    gone_since_m = 1.6 * 0.15 + 0.035  # what touches counts from the plain clearance and the arm's own error on
    for left_m, share in ((gone_since_m - 0.03, 0.0), (gone_since_m + 0.1, 1.0)):
        seen = beside_the_tool(ur5e_checker, left_m, valid_ms=SEEN)
        assert decided_since(ur5e_checker, overtakes, seen, velocity=-TURNING).speed_fraction == share


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


def test_furniture_gets_plain_clearance(ur5e_checker: ArmCollisionChecker) -> None:
    table = beside_the_tool(ur5e_checker, 0.2, kind=ObstacleKind.STATIC)
    person = replace(table, kind=ObstacleKind.MOVING)
    assert decided(ur5e_checker, table).speed_fraction > decided(ur5e_checker, person).speed_fraction
    unseen = replace(table, kind=ObstacleKind.UNSEEN)
    assert decided(ur5e_checker, unseen).speed_fraction == decided(ur5e_checker, table).speed_fraction
    touching = beside_the_tool(ur5e_checker, 0.06, kind=ObstacleKind.STATIC)
    assert decided(ur5e_checker, touching).speed_fraction == 0.0


def test_unknown_space_follows_the_policy(ur5e_checker: ArmCollisionChecker) -> None:
    dark = beside_the_tool(ur5e_checker, 0.12, kind=ObstacleKind.UNKNOWN)
    by_law = decided(ur5e_checker, dark)
    as_furniture = decided(ur5e_checker, dark, unknown=UnknownPolicy.CLEARANCE)
    assert by_law.speed_fraction < as_furniture.speed_fraction
    assert by_law.term_intrusion == 0.2
    assert as_furniture.term_intrusion == 0.03
    for kind in (ObstacleKind.UNKNOWN, ObstacleKind.UNSEEN):
        over = replace(dark, size=(0.5,) * 3, kind=kind)
        assert decided(ur5e_checker, over).speed_fraction == 0.0
        assert decided(ur5e_checker, over, unknown=UnknownPolicy.IGNORE).speed_fraction == 1.0


def test_what_comes_after_the_arm_has_stopped_does_not_count(ur5e_checker: ArmCollisionChecker) -> None:
    close = beside_the_tool(ur5e_checker, 0.12)
    stop_ms = 1e3 * (REACTION_S + stopping_table("ur5e").stop(TURNING).duration_s)
    late = replace(close, valid_ms=(int(stop_ms) + 5, 200))
    assert decided(ur5e_checker, late).speed_fraction == 1.0
    in_time = replace(close, valid_ms=(20, 200))
    assert decided(ur5e_checker, in_time).speed_fraction == 0.0


def test_an_earlier_layer_ends_and_the_last_goes_on(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(
        obstacles(
            beside_the_tool(ur5e_checker, 0.12, valid_ms=(0, 50)),  # a hand that is being drawn back
            beside_the_tool(ur5e_checker, 0.9, valid_ms=(150, 200)),
            Thing((0.0, -3.0, 0.0), kind=ObstacleKind.STATIC, valid_ms=(0, 10_000)),
        )
    )
    assert decide(ur5e_checker, ahead(TURNING), NOW, REACTION_S).speed_fraction == 0.0
    after = decide(ur5e_checker, ahead(TURNING, NOW + 60 * MS), NOW + 60 * MS, REACTION_S)
    assert after.speed_fraction == 1.0
    assert after.obstacle_id != 100


def test_the_distance_is_taken_along_the_path(ur5e_checker: ArmCollisionChecker) -> None:
    found = decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.3))
    assert found.distance < ur5e_checker.distance(READY).distance
    assert found.distance == pytest.approx(ur5e_checker.distance(READY + TURNING * 0.2).distance, abs=1e-6)


def test_nothing_around_is_clear(ur5e_checker: ArmCollisionChecker) -> None:
    found = decided(ur5e_checker)
    assert (found.speed_fraction, found.reason, found.obstacle_id, found.link) == (1.0, "clear", -1, "")
    assert found.distance == np.inf
    far = decided(ur5e_checker, Thing((4.0, 0.0, 0.0), size=(1.0, 0.5, 0.2), shape=ObstacleShape.BOX))
    assert (far.speed_fraction, far.reason, far.obstacle_id) == (1.0, "clear", 100)


def test_joints_in_another_order_are_the_same_arm(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.3)))
    path = ahead(TURNING)
    turned = JointPath(path.names[::-1], path.stamps, path.positions[:, ::-1])
    assert decide(ur5e_checker, turned, NOW, REACTION_S) == decide(ur5e_checker, path, NOW, REACTION_S)
    with pytest.raises(ArmError, match="present pose"):
        decide(ur5e_checker, JointPath(path.names, path.stamps[:0], path.positions[:0]), NOW, REACTION_S)


def test_a_single_pose_is_an_arm_that_stands(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.1)))
    path = ahead(TURNING)
    standing = decide(ur5e_checker, JointPath(path.names, path.stamps[:1], path.positions[:1]), NOW, REACTION_S)
    assert standing.speed_fraction == 1.0
    assert standing.distance < 0.15


def test_an_arm_of_seven_joints_gets_a_speed(ur5e_checker: ArmCollisionChecker, tmp_path: Path) -> None:
    """Any serial arm from a file: here a UR5e with one joint more, which its stopping data know nothing of."""
    file = tmp_path / "seven.xml"
    bare = write_mjcf(ur_model("ur5e"))
    head, tail = bare.split('<geom name="wrist_3_link_0"')
    geom, rest = tail.split("/>", 1)
    hand = f'<body name="hand"><joint name="seventh" axis="0 0 1"/><geom name="hand"{geom}/></body>'
    file.write_text(f'{head}<geom name="wrist_3_link_0"{geom}/>{hand}{rest}')
    checker = ArmCollisionChecker(str(file))
    path = extrapolate(checker.model, np.append(READY, 0.0), np.append(TURNING, 0.0), NOW)
    slowed = {}
    for left_m in (0.3, 0.45, 2.0):
        checker.update(obstacles(beside_the_tool(ur5e_checker, left_m)))
        slowed[left_m] = decide(checker, path, NOW, REACTION_S).speed_fraction
    assert slowed[0.3] < slowed[0.45] < slowed[2.0] == 1.0


@pytest.mark.parametrize("name", ["human_speed", "intrusion_m", "clearance_m", "position_error_m", "closing_speed"])
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_constants_that_no_law_has_are_refused(name: str, value: float) -> None:
    with pytest.raises(ArmError, match=f"{name}: expected a number of 0 or more, found {value:g}"):
        SeparationParameters(**{name: value})


GOOD = ahead(TURNING)


@pytest.mark.parametrize(
    ("path", "reaction_s", "word"),
    [
        (replace(GOOD, stamps=GOOD.stamps[::-1]), REACTION_S, "expected strictly increasing stamps"),
        (replace(GOOD, stamps=np.full(21, NOW)), REACTION_S, "expected strictly increasing stamps"),
        (replace(GOOD, positions=GOOD.positions[:5]), REACTION_S, "expected one pose per stamp, found 5 and 21"),
        (replace(GOOD, stamps=GOOD.stamps[:0], positions=GOOD.positions[:0]), REACTION_S, "found no sample"),
        (GOOD, -1.0, "reaction_s: expected 0 or more seconds, found -1"),
        (GOOD, np.nan, "reaction_s: expected 0 or more seconds, found nan"),
        (GOOD, np.inf, "reaction_s: expected 0 or more seconds, found inf"),
    ],
)
def test_paths_and_reactions_that_cannot_be_are_refused_not_called_clear(
    ur5e_checker: ArmCollisionChecker, path: JointPath, reaction_s: float, word: str
) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.25)))
    with pytest.raises(ArmError, match=word):
        decide(ur5e_checker, path, NOW, reaction_s)


def test_a_law_that_gives_no_number_lets_nothing_move(ur5e_checker: ArmCollisionChecker) -> None:
    """Of a velocity whose square is infinite it said "clear"."""
    infinite = SeparationParameters(intrusion_m=1e308, position_error_m=1.7e308)
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.25)))
    with np.errstate(over="ignore"), pytest.raises(ArmError, match="protective distance from obstacle 100, found inf"):
        decide(ur5e_checker, ahead(TURNING), NOW, REACTION_S, infinite)
    motion = Motion(NOW, REACTION_S, TURNING, stopping_table("ur5e"))
    found = hazards(ur5e_checker.obstacles, NOW, SeparationParameters())
    pair, one = np.zeros(1, np.int64), np.ones(1)
    unknown = Encounter(found, pair, pair, np.full(1, np.nan), one, motion, SeparationParameters())
    assert np.isnan(unknown.shortfall(1.0)).all()
    assert unknown.largest_share() == 0.0
