"""The separation law: each term against arithmetic, and what it must and must not slow for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from obstacle_sets import MS, NOW, Thing, obstacles
from turning_arm import REACTION_S, READY, TURNING, ahead, beside_the_tool, decided, decided_since

from twin_node.arm import (
    ArmCollisionChecker,
    ArmError,
    StoppingTable,
    UnknownPolicy,
    decide,
    extrapolate,
    stopping_table,
)
from twin_node.arm.ur import servo_stopping
from twin_node.robot import RobotError, forward_kinematics, ur_model
from twin_node.robot.mjcf import write_mjcf
from twin_node.robot.ur import JOINT_NAMES
from twin_node.scene import JointPath, JointSample, ObstacleKind, ObstacleShape


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
    assert (found.stamp, found.obstacle_id) == (NOW, 100)


def test_a_decision_tells_the_stamp_of_its_evidence(ur5e_checker: ArmCollisionChecker) -> None:
    found = decided_since(ur5e_checker, beside_the_tool(ur5e_checker, 0.3))
    assert (found.stamp, found.evidence_stamp) == (NOW, NOW - 150 * MS)


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


def test_who_overtakes_an_arm_that_stops_late_is_looked_for_until_it_stands(ur5e_checker: ArmCollisionChecker) -> None:
    """A servoed arm stops in half a second, and a forecast ends before: hands from behind met it at 0.3 m/s."""
    late = servo_stopping(ur5e_checker.model, stopping_table("ur5e"))
    draws_back, before_it = np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.1, 0.0, -0.1])
    tool = forward_kinematics(ur5e_checker.model, READY)[-1, :3, 3]
    after_s = REACTION_S + late.stop(draws_back).duration_s - 0.2

    def share(gap_m: float, speed: float, table: StoppingTable = late) -> float:
        hand = Thing(tuple(tool + before_it + [gap_m, 0.0, 0.0]), size=(0.1,) * 3, velocity=(-speed, 0.0, 0.0))
        ur5e_checker.update(obstacles(hand))
        return decide(ur5e_checker, ahead(draws_back), NOW, REACTION_S, table=table).speed_fraction

    assert after_s > 0.3
    assert share(0.2, 0.0) == share(0.2, 0.1) == 1.0  # who follows slowly does not get there
    assert share(0.2, 1.0, stopping_table("ur5e")) == 1.0  # nor does anybody in time
    assert 0.0 < share(0.2, 2.0) < share(0.2, 1.0) < 0.5
    assert share(0.2 + after_s, 1.0) == 1.0


def test_an_arm_that_creeps_up_to_somebody_stops(ur5e_checker: ArmCollisionChecker) -> None:
    close = beside_the_tool(ur5e_checker, 0.12)
    assert decided(ur5e_checker, close, velocity=0.05 * TURNING).speed_fraction == 0.0


def speeding_up(sign: float) -> JointPath:
    """From rest to 2 rad/s about the base within 200 ms; a positive sign leads to the arm's left."""
    offsets = np.arange(0, 201 * MS, 10 * MS)
    way = sign * 5.0 * (offsets * 1e-9) ** 2
    return JointPath(JOINT_NAMES, NOW + offsets, READY + TURNING * way[:, None])


@pytest.mark.parametrize(("sign", "left_m"), [(1.0, 0.42), (-1.0, -0.52)])
def test_an_arm_that_begins_to_move_stops_as_late_as_at_its_fastest(
    ur5e_checker: ArmCollisionChecker, sign: float, left_m: float
) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, left_m, valid_ms=(0, 20))))
    found = decide(ur5e_checker, speeding_up(sign), NOW, REACTION_S)
    stop = stopping_table("ur5e").stop(1.95 * TURNING)  # the mean of the last 10 ms
    assert found.term_human == pytest.approx(1.6 * (REACTION_S + stop.duration_s - 0.020), abs=1e-6)
    assert found.speed_fraction < 1.0


def test_an_arm_that_begins_to_move_reaches_as_far_as_at_its_fastest(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.27)))
    assert decide(ur5e_checker, speeding_up(1.0), NOW, REACTION_S).reason == "slow for MOVING"


def test_a_fast_arm_stops_for_what_it_would_touch_and_be_past_within_50_ms(ur5e_checker: ArmCollisionChecker) -> None:
    """Its distance was looked at every 50 ms: at the next look a fast arm had left what it had grazed in between."""
    outwards = forward_kinematics(ur5e_checker.model, READY + 0.07 * TURNING)[-1, :3, 3] * [1, 1, 0]
    grazed = forward_kinematics(ur5e_checker.model, READY + 0.07 * TURNING)[-1, :3, 3]
    grazed = grazed + outwards / np.linalg.norm(outwards) * 0.088
    ball = Thing(tuple(grazed), size=(0.1,) * 3, kind=ObstacleKind.STATIC)
    assert decided(ur5e_checker, ball, velocity=3 * TURNING).reason == "stopped for STATIC"


def test_an_arm_that_leaves_stands_for_what_may_touch_it(ur5e_checker: ArmCollisionChecker) -> None:
    for velocity in (-TURNING, 0.05 * -TURNING):
        overtaken = decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.06), velocity=velocity)
        assert overtaken.speed_fraction == 0.0
        assert overtaken.reason == "stopped for MOVING"
        assert decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.1), velocity=velocity).speed_fraction == 1.0
    for kind in (ObstacleKind.STATIC, ObstacleKind.UNKNOWN):  # nothing comes out of the one; an arm has its own shadow
        beside = beside_the_tool(ur5e_checker, 0.06, kind=kind)
        assert decided(ur5e_checker, beside, velocity=-TURNING).speed_fraction == 1.0


def test_what_is_nearer_than_the_arms_own_error_may_touch_it(ur5e_checker: ArmCollisionChecker) -> None:
    """Beyond the clearance, which alone would let the arm leave."""
    beside = beside_the_tool(ur5e_checker, 0.1)
    ur5e_checker.update(obstacles(beside))
    nearer = ur5e_checker.distance(READY).distance - 0.033
    x, y, z = beside.position
    found = decided(ur5e_checker, replace(beside, position=(x, y - nearer, z)), velocity=-TURNING)
    assert 0.03 < ur5e_checker.distance(READY).distance < 0.035
    assert found.speed_fraction == 0.0


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
    now_far_away = Thing((0.0, -5.0, 0.5))  # the forecast begins at once
    late = replace(close, valid_ms=(int(stop_ms) + 5, 200))
    assert decided(ur5e_checker, now_far_away, late).speed_fraction == 1.0
    in_time = replace(close, valid_ms=(20, 200))
    assert decided(ur5e_checker, in_time).speed_fraction == 0.0
    as_it_brakes = replace(close, valid_ms=(int(stop_ms) - 5, 200))  # a little slower it stands by then
    assert 0.8 < decided(ur5e_checker, now_far_away, as_it_brakes).speed_fraction < 1.0


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


def test_where_a_later_layer_takes_over_an_earlier_one_does_not_grow(ur5e_checker: ArmCollisionChecker) -> None:
    drawn_back = beside_the_tool(ur5e_checker, 0.42, valid_ms=(0, 50))
    assert decided(ur5e_checker, drawn_back).speed_fraction < 1.0
    assert decided(ur5e_checker, drawn_back, Thing((0.0, -5.0, 0.5), valid_ms=(50, 200))).speed_fraction == 1.0


def test_obstacles_of_one_layer_may_end_some_milliseconds_apart(ur5e_checker: ArmCollisionChecker) -> None:
    """As others than the twin may publish them: the one that ends first is not gone when it does."""
    ur5e_checker.update(
        obstacles(
            beside_the_tool(ur5e_checker, 0.12, valid_ms=(150, 190)),
            beside_the_tool(ur5e_checker, 0.9, valid_ms=(150, 200)),
        )
    )
    after = NOW + 195 * MS
    assert decide(ur5e_checker, ahead(TURNING, after), after, REACTION_S).speed_fraction == 0.0


@pytest.mark.parametrize("kind", [ObstacleKind.MOVING, ObstacleKind.UNKNOWN])
def test_whom_no_later_layer_takes_over_goes_on_though_others_are_foretold_for_longer(
    ur5e_checker: ArmCollisionChecker, kind: ObstacleKind
) -> None:
    """As a tracker of people publishes them, one obstacle each: who is foretold for less was gone when that ended."""
    for_longer = Thing((0.0, -5.0, 0.5), kind=kind, valid_ms=(0, 200))
    ends_first = beside_the_tool(ur5e_checker, 0.42, kind=kind, valid_ms=(0, 50))
    alone = decided(ur5e_checker, ends_first)
    assert alone.speed_fraction < 1.0
    beside = decided(ur5e_checker, ends_first, for_longer)
    assert (beside.speed_fraction, beside.obstacle_id) == (alone.speed_fraction, 100)
    after = NOW + 100 * MS
    ur5e_checker.update(obstacles(ends_first, for_longer))
    later = decide(ur5e_checker, ahead(TURNING, after), after, REACTION_S)
    assert later.speed_fraction < beside.speed_fraction


def test_the_distance_is_taken_along_the_path(ur5e_checker: ArmCollisionChecker) -> None:
    found = decided(ur5e_checker, beside_the_tool(ur5e_checker, 0.3))
    assert found.distance < ur5e_checker.distance(READY).distance
    assert found.distance == pytest.approx(ur5e_checker.distance(READY + TURNING * 0.2).distance, abs=1e-6)


def test_poses_after_the_forecast_are_held_against_its_last_layer(ur5e_checker: ArmCollisionChecker) -> None:
    """Of its own kind: furniture is said to stand for longer."""
    furniture = Thing((0.0, -3.0, 0.0), kind=ObstacleKind.STATIC, valid_ms=(0, 10_000))
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.3), furniture))
    late = NOW + 150 * MS
    found = decide(ur5e_checker, ahead(TURNING, late), late, REACTION_S)
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


@pytest.mark.parametrize("left_m", [0.02, 0.1, 0.28])
@pytest.mark.parametrize("early_ms", [30, 90])
def test_what_a_forecast_holds_first_is_there_before_it_begins(
    ur5e_checker: ArmCollisionChecker, left_m: float, early_ms: int
) -> None:
    at_once = beside_the_tool(ur5e_checker, left_m)
    slow = 0.05 * TURNING  # stands before the forecast begins, so soon that nothing would come in time
    for velocity in (TURNING, slow, -TURNING):
        later = replace(at_once, valid_ms=(early_ms, 200 + early_ms))
        seen = replace(at_once, valid_ms=(0, 0), reach=(0.05, 0.0))  # it keeps still until then
        expected = decided(ur5e_checker, at_once, velocity=velocity)
        found = decided(ur5e_checker, later, seen, velocity=velocity)
        assert found.speed_fraction <= expected.speed_fraction + 0.2
        assert (found.reason, found.distance) == (expected.reason, pytest.approx(expected.distance, abs=1e-6))


def test_what_stands_from_the_evidence_on_hides_no_first_layer(ur5e_checker: ArmCollisionChecker) -> None:
    """Beside a table that counts already, who was forecast from 80 ms on was nowhere yet: an arm crept up to them."""
    somebody = beside_the_tool(ur5e_checker, 0.1, valid_ms=(80, 280))
    table = Thing((3.0, 0.0, 0.0), kind=ObstacleKind.STATIC, valid_ms=(0, 1000))
    found = decided(ur5e_checker, somebody, table, velocity=0.05 * TURNING)
    assert (found.speed_fraction, found.reason) == (0.0, "stopped for MOVING")
    assert ur5e_checker.distance(READY, NOW).obstacle_id == 100


def test_an_arm_that_still_brakes_is_faster_than_it_is_told(ur5e_checker: ArmCollisionChecker) -> None:
    """It counted as if it were as fast as that already, and came 2 cm nearer to furniture than it should."""
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.16, kind=ObstacleKind.STATIC)))
    late = servo_stopping(ur5e_checker.model, stopping_table("ur5e"))

    def told(going: float | None) -> float:
        joints = None if going is None else JointSample(NOW, JOINT_NAMES[::-1], READY[::-1], going * TURNING[::-1])
        return decide(ur5e_checker, ahead(TURNING), NOW, REACTION_S, table=late, joints=joints).speed_fraction

    free = told(None)
    assert 0.4 < free < 0.9
    assert told(0.0) == told(free) == free  # it gets no faster than it is let
    shares = [told(going) for going in (free, 0.85, 0.9, 1.0, 1.5)]
    assert shares == sorted(shares, reverse=True)
    assert shares[3] < free - 0.1
    assert shares[4] == 0.0
    with pytest.raises(RobotError, match="shoulder_pan_joint"):
        decide(ur5e_checker, ahead(TURNING), NOW, REACTION_S, joints=JointSample(NOW, ("a",), np.zeros(1), np.zeros(1)))
