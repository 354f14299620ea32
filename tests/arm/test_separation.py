"""The separation law as a whole: how proofs are put together, and that nothing which matters is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from obstacle_sets import MS, NOW, Thing, obstacles, random_obstacles
from turning_arm import REACTION_S, READY, SEEN, TURNING, ahead, beside_the_tool, decided, decided_since

from twin_node.arm import (
    Approaches,
    ArmCollisionChecker,
    SeparationParameters,
    Underway,
    UnknownPolicy,
    decide,
    stopping_table,
)
from twin_node.arm.course import ArmMotion
from twin_node.arm.separation import Encounter, Proof, hazards
from twin_node.arm.ur import servo_stopping
from twin_node.geometry import quat_from_rotation, rotation_from_quat
from twin_node.robot import forward_kinematics
from twin_node.robot.ur import JOINT_NAMES
from twin_node.scene import JointPath, JointSample, ObstacleKind


@given(seed=st.integers(0, 10_000), speed=st.floats(-3.0, 3.0))
@settings(max_examples=15, deadline=None)
def test_no_obstacle_that_is_left_out_as_too_far_would_have_slowed_the_arm(
    ur5e_checker: ArmCollisionChecker, seed: int, speed: float
) -> None:
    generator = np.random.default_rng(seed)
    things = random_obstacles(4, seed, spread=2.5)
    kinds = generator.choice([ObstacleKind.MOVING, ObstacleKind.STATIC], 4).astype(np.uint8)
    ur5e_checker.update(replace(things, kinds=kinds, velocities=generator.normal(size=(4, 3))))
    path = ahead(speed * np.array([1.0, 0.3, 0.0, 0.5, 0.0, 0.0]))
    among_near_ones = decide(ur5e_checker, path, NOW, REACTION_S)
    look = ur5e_checker.approaches
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ur5e_checker, "approaches", lambda q, reach: look(q, np.where(reach < 0, reach, 100.0)))
        among_all = decide(ur5e_checker, path, NOW, REACTION_S)
    assert among_near_ones.speed_fraction == among_all.speed_fraction


@given(seed=st.integers(0, 10_000), speed=st.floats(-3.0, 3.0), yaw=st.floats(-3.0, 3.0))
@settings(max_examples=60, deadline=None)
def test_neither_the_order_of_obstacles_nor_where_all_is_turned_to_about_the_base_changes_the_speed(
    ur5e_checker: ArmCollisionChecker, seed: int, speed: float, yaw: float
) -> None:
    """Nor the order of the joints: rows, columns, turns and signs are the same everywhere."""
    generator = np.random.default_rng(seed)
    things = random_obstacles(8, seed, spread=1.6)
    kinds = generator.choice(np.array(ObstacleKind, np.uint8), 8)
    seen = np.arange(8) < 4  # what moves, where it was seen
    stamps = {"stamp": NOW - 50 * MS, "valid_to": np.where(seen, NOW - 50 * MS, things.valid_to)}
    stamps["valid_from"] = np.where(seen, NOW - 50 * MS, things.valid_from)
    things = replace(things, kinds=kinds, velocities=2 * generator.normal(size=(8, 3)), **stamps)
    path = ahead(speed * np.array([1.0, 0.3, 0.0, 0.5, 0.0, 0.0]))
    measured = JointSample(NOW, JOINT_NAMES, READY, 150 * (path.positions[1] - path.positions[0]))  # 1.5 times as fast
    ur5e_checker.update(things)
    told = decide(ur5e_checker, path, NOW, REACTION_S, joints=measured)

    turn, pan = rotation_from_quat([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]), np.array([yaw, 0, 0, 0, 0, 0])
    turned = replace(
        things,
        positions=things.positions @ turn.T,
        velocities=things.velocities @ turn.T,
        quats=quat_from_rotation(turn @ rotation_from_quat(things.quats)),
    )
    rows, joints = generator.permutation(8), generator.permutation(6)
    names = tuple(JOINT_NAMES[joint] for joint in joints)
    ur5e_checker.update(turned.only(rows))
    again = decide(
        ur5e_checker,
        JointPath(names, path.stamps, (path.positions + pan)[:, joints]),
        NOW,
        REACTION_S,
        joints=JointSample(NOW, names, (READY + pan)[joints], measured.velocities[joints]),
    )
    assert again.speed_fraction == pytest.approx(told.speed_fraction, abs=2e-3)
    if told.distance > 0:  # depths of contacts are MuJoCo's
        assert again.distance == pytest.approx(told.distance, abs=1e-6)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_a_capsule_is_proven_by_sight_or_by_forecast_with_the_better_way_there(
    ur5e_checker: ArmCollisionChecker, seed: int
) -> None:
    """Of everything by sight alone, of a forecast also until it begins; what stands, and the unknown, always count."""
    generator = np.random.default_rng(seed)
    seen = beside_the_tool(ur5e_checker, 0.5, valid_ms=SEEN)
    forecast = beside_the_tool(ur5e_checker, 0.5, valid_ms=(250, 450))
    later = beside_the_tool(ur5e_checker, 0.5, valid_ms=(350, 450))
    table = beside_the_tool(ur5e_checker, 0.5, kind=ObstacleKind.STATIC, valid_ms=(0, 10_000))
    ur5e_checker.update(obstacles(seen, forecast, later, table, stamp=NOW - 150 * MS))
    capsules, rows = np.indices((3, 4)).reshape(2, -1)
    used = generator.random(12) < 0.7
    capsules, rows = capsules[used], rows[used]
    pairs = Approaches(capsules, rows, generator.uniform(0.0, 1.2, (1, len(rows))))
    law = SeparationParameters()
    encounter = Encounter.of(
        hazards(ur5e_checker.obstacles, NOW, law),
        pairs,
        generator.uniform(0.0, 1.5, len(rows)),
        ArmMotion(NOW, 0.3, TURNING, stopping_table("ur5e")),
        law,
    )
    short = encounter._alone(1.0)

    def worst(proof: Proof, capsule: int) -> float:
        return short[(encounter.proofs == proof) & (encounter.capsules == capsule)].max(initial=-np.inf)

    told = encounter.shortfall(1.0)
    for capsule in range(3):
        before = min(worst(Proof.FIRST_BEFORE, capsule), worst(Proof.SEEN_BEFORE, capsule))
        proven = min(worst(Proof.SIGHT, capsule), max(worst(Proof.FORECAST, capsule), before))
        expected = max(worst(Proof.EVERY, capsule), proven)
        assert told[encounter.capsules == capsule].max(initial=-np.inf) == expected


@pytest.mark.parametrize("early_ms", [30, 190])
def test_somebody_seen_in_the_future_is_no_farther_than_somebody_seen_now(
    ur5e_checker: ArmCollisionChecker, early_ms: int
) -> None:
    """The clocks differ: what they told counted as younger than it was, and the arm kept up to 0.3 m less."""
    layers = ((0.4, (0, 0)), (0.4, (20, 70)), (0.25, (70, 120)))
    things = [beside_the_tool(ur5e_checker, left_m, valid_ms=times) for left_m, times in layers]
    ur5e_checker.update(obstacles(*things))
    expected = decide(ur5e_checker, ahead(TURNING), NOW, REACTION_S)
    later = [replace(thing, valid_ms=tuple(ms + early_ms for ms in thing.valid_ms)) for thing in things]
    ur5e_checker.update(obstacles(*later, stamp=NOW + early_ms * MS))
    found = decide(ur5e_checker, ahead(TURNING), NOW, REACTION_S)
    assert 0 < expected.speed_fraction < 1
    assert (found.speed_fraction, found.required) == (expected.speed_fraction, expected.required)
    assert found.evidence_stamp == NOW + early_ms * MS


def test_before_its_forecast_begins_who_was_seen_gets_as_far_as_until_then_or_until_the_arm_stands(
    ur5e_checker: ArmCollisionChecker,
) -> None:
    law = SeparationParameters()
    seen = beside_the_tool(ur5e_checker, 0.5, valid_ms=SEEN)
    forecast = Thing((0.0, 5.0, 0.0), valid_ms=(200, 400))
    ur5e_checker.update(obstacles(seen, forecast, stamp=NOW - 150 * MS))
    pair = Approaches(np.zeros(1, np.int64), np.zeros(1, np.int64), np.full((1, 1), 0.3))
    found = hazards(ur5e_checker.obstacles, NOW, law)
    for reaction_s in (0.05, 0.6):
        motion = ArmMotion(NOW, reaction_s, TURNING, stopping_table("ur5e"))
        encounter = Encounter.of(found, pair, np.ones(1), motion, law)
        stands_s = reaction_s + stopping_table("ur5e").stop(TURNING).duration_s
        until_s = min(stands_s, 0.2)
        terms = encounter.terms(1.0)
        assert encounter.proofs.tolist() == [Proof.SIGHT, Proof.SEEN_BEFORE]
        assert terms.human == pytest.approx([1.6 * (0.15 + stands_s), 1.6 * (0.15 + until_s)])
        assert terms.reaction == pytest.approx([reaction_s, min(reaction_s, 0.2)])  # at 1 m/s
        assert terms.intrusion.tolist() == [0.2, 0.03]


def test_what_the_arm_closes_in_on_from_far_enough_away_is_named_and_slows_nothing(
    ur5e_checker: ArmCollisionChecker,
) -> None:
    table = beside_the_tool(ur5e_checker, 0.25, kind=ObstacleKind.STATIC)
    found = decided(ur5e_checker, table, velocity=2.5 * TURNING)
    assert (found.speed_fraction, found.reason) == (1.0, "clear of STATIC")
    assert found.required > 0.1


def test_the_pair_that_decides_is_named_not_the_closest_one(ur5e_checker: ArmCollisionChecker) -> None:
    table = beside_the_tool(ur5e_checker, -0.2, kind=ObstacleKind.STATIC)  # the arm leaves it
    person = beside_the_tool(ur5e_checker, 0.28)
    found = decided(ur5e_checker, table, person)
    assert (found.obstacle_id, found.reason) == (101, "slow for MOVING")
    assert found.link in ur5e_checker.capsule_names
    away = decided(ur5e_checker, table, person, velocity=np.zeros(6))
    assert away.reason == "not closing in"
    assert away.link in ur5e_checker.capsule_names


def test_people_keep_their_distance_whatever_unknown_space_counts_as(ur5e_checker: ArmCollisionChecker) -> None:
    person = beside_the_tool(ur5e_checker, 0.2)
    by_law = decided(ur5e_checker, person)
    for unknown in (UnknownPolicy.CLEARANCE, UnknownPolicy.IGNORE):
        assert decided(ur5e_checker, person, unknown=unknown) == by_law


@pytest.mark.parametrize("toward_the_arm", [-0.5, 0.0, 0.5])
@pytest.mark.parametrize("retreat", [0.05, 1.0, 3.0])
def test_however_fast_it_leaves_an_arm_stands_for_whoever_may_touch_it(
    ur5e_checker: ArmCollisionChecker, retreat: float, toward_the_arm: float
) -> None:
    """Neither its own speed away from them nor theirs makes room for its stop."""
    hand = beside_the_tool(ur5e_checker, 0.06, velocity=(0.0, -toward_the_arm, 0.0))
    found = decided(ur5e_checker, hand, velocity=-retreat * TURNING)
    assert (found.speed_fraction, found.reason) == (0.0, "stopped for MOVING")


@pytest.mark.parametrize("count", [2, 3, 5, 21])
def test_a_path_told_coarsely_is_the_same_path(ur5e_checker: ArmCollisionChecker, count: int) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.29)))
    stamps = NOW + np.linspace(0, 200 * MS, count).astype(np.int64)
    positions = READY + TURNING * (stamps - NOW)[:, None] * 1e-9
    found = decide(ur5e_checker, JointPath(JOINT_NAMES, stamps, positions), NOW, REACTION_S)
    fine = decide(ur5e_checker, ahead(TURNING), NOW, REACTION_S)
    assert found.speed_fraction == pytest.approx(fine.speed_fraction, abs=0.05)
    assert found.required == pytest.approx(fine.required, abs=0.01)


def test_an_arm_that_goes_forth_and_back_within_the_forecast_comes_closer_meanwhile(
    ur5e_checker: ArmCollisionChecker,
) -> None:
    """A stroke of 1 cm, shorter than the stride of its poses."""
    path = ahead(TURNING)
    there_and_back = READY + TURNING * 0.01 * np.sin(np.linspace(0, np.pi, 21))[:, None]
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.12)))
    found = decide(ur5e_checker, replace(path, positions=there_and_back), NOW, REACTION_S)
    assert (found.speed_fraction, found.reason) == (0.0, "stopped for MOVING")


def test_how_fast_an_arm_goes_is_told_by_its_joints_share_of_their_speeds(ur5e_checker: ArmCollisionChecker) -> None:
    """Whichever way they turn; a joint that is not to move tells little by its noise, an arm that stands nothing."""
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.12, kind=ObstacleKind.STATIC)))
    plan, noise = 2.5 * TURNING, np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])

    def told(velocities: np.ndarray, plan: np.ndarray = plan) -> float:
        joints = JointSample(NOW, JOINT_NAMES, READY, velocities)
        return decide(ur5e_checker, ahead(plan), NOW, REACTION_S, joints=joints).speed_fraction

    free = told(np.zeros(6))
    assert 0.1 < free < 0.9
    assert told(plan) == told(-plan) < free - 0.05
    assert told(free * plan) == told(noise) == free
    assert told(noise, np.zeros(6)) == 1.0


def test_a_slow_joint_that_is_faster_than_planned_makes_the_arm_as_much_faster(
    ur5e_checker: ArmCollisionChecker,
) -> None:
    """However fast another joint is: each counts by its own speed."""
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.12, kind=ObstacleKind.STATIC)))
    wrist = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.5])

    def told(velocities: np.ndarray) -> float:
        joints = JointSample(NOW, JOINT_NAMES, READY, velocities)
        return decide(ur5e_checker, ahead(TURNING + wrist), NOW, REACTION_S, joints=joints).speed_fraction

    assert told(1.4 * TURNING) == told(1.4 * (TURNING + wrist)) < told(np.zeros(6)) - 0.05


def test_an_arm_that_is_slow_later_is_held_for_what_it_may_reach_before(ur5e_checker: ArmCollisionChecker) -> None:
    """It turns at 3 rad/s for 50 ms and stands: by its mean speed what it closes in on first was too far away."""
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.3, kind=ObstacleKind.STATIC)))
    path = ahead(3 * TURNING)
    stands = replace(path, positions=np.minimum(path.positions, path.positions[5]))
    found = decide(ur5e_checker, stands, NOW, 0.2)
    assert (found.reason, found.speed_fraction < 1) == ("slow for STATIC", True)


def test_an_arm_goes_on_as_it_was_told_before_until_it_hears_of_less(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.16, kind=ObstacleKind.STATIC)))
    late = servo_stopping(ur5e_checker.model, stopping_table("ur5e"))

    def told(underway: Underway | None) -> float:
        return decide(ur5e_checker, ahead(TURNING), NOW, REACTION_S, table=late, underway=underway).speed_fraction

    free, slower, faster = (told(underway) for underway in (None, Underway(0.02, 0.8), Underway(0.02, 1.0)))
    assert 1.0 > free > slower > faster == 0.0


def test_one_layer_may_begin_and_kinds_may_end_some_milliseconds_apart(ur5e_checker: ArmCollisionChecker) -> None:
    """Both of who is forecast first may be there before that, and what is unknown for less long ends no other's."""
    somebody = beside_the_tool(ur5e_checker, 0.1, valid_ms=(90, 280))
    another = Thing((0.0, -3.0, 0.5), valid_ms=(80, 280))
    assert decided(ur5e_checker, somebody, another, velocity=0.05 * TURNING).speed_fraction == 0.0
    drawn_back = beside_the_tool(ur5e_checker, 0.42, valid_ms=(0, 50))
    last = Thing((0.0, -5.0, 0.5), valid_ms=(50, 200))
    dark = Thing((0.0, -5.0, 0.5), kind=ObstacleKind.UNKNOWN, valid_ms=(0, 40))
    assert decided(ur5e_checker, drawn_back, last, dark).speed_fraction == 1.0


def test_what_is_told_of_who_was_seen_bounds_no_forecast(ur5e_checker: ArmCollisionChecker) -> None:
    """A layer grows by people's speed from its end on, whatever it says of reaches."""
    short = beside_the_tool(ur5e_checker, 0.42, valid_ms=(0, 20))
    expected = decided_since(ur5e_checker, short)
    assert expected.speed_fraction < 1.0
    assert decided_since(ur5e_checker, replace(short, reach=(0.01, 0.0))) == expected


@pytest.mark.parametrize(
    ("speed", "reaction_s", "degrees"),
    [*((3.0, REACTION_S, degrees) for degrees in (60, 80, 90, 110)), (1.5, 0.3, 60), (1.5, 0.5, 60), (1.5, 0.5, 80)],
)
def test_a_way_to_standstill_that_is_longer_than_the_path_is_gone_to_its_end(
    ur5e_checker: ArmCollisionChecker, speed: float, reaction_s: float, degrees: int
) -> None:
    """A ball abreast of a turning arm is approached the faster the nearer it is: a servoed arm went on into it, for the
    speed of the first 200 ms counted for all of its way of 0.5 s. Its way until it reacts is a part of that."""
    plan, late = speed * TURNING, servo_stopping(ur5e_checker.model, stopping_table("ur5e"), 0.2)
    tool = forward_kinematics(ur5e_checker.model, READY + np.deg2rad(degrees) * TURNING)[-1, :3, 3]
    ur5e_checker.update(obstacles(Thing(tuple(tool), size=(0.1,) * 3, kind=ObstacleKind.STATIC, valid_ms=(0, 10_000))))
    share = decide(ur5e_checker, ahead(plan), NOW, reaction_s, table=late).speed_fraction
    course = ArmMotion(NOW, reaction_s, plan, late).course(share)
    way_s = np.linspace(0, course.steady_s + course.braking_s, 30)
    nearest = ur5e_checker.check(READY + way_s[:, None] * plan, np.full(30, NOW))
    assert 0.0 < share <= 1.0
    assert min(one.distance for one in nearest) > 0.03
