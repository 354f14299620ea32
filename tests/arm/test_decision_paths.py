"""What is decided of a path is decided of where it leads, however it is told."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from obstacle_sets import MS, NOW, obstacles
from turning_arm import REACTION_S, READY, TURNING, ahead, beside_the_tool

from twin_node.arm import ArmCollisionChecker, decide, sample_path, stopping_table
from twin_node.arm.course import ArmMotion
from twin_node.arm.decision import _picked, _until_standstill
from twin_node.arm.ur import servo_stopping
from twin_node.robot.ur import JOINT_NAMES
from twin_node.scene import JointPath, JointSample, ObstacleKind


def through(ms: list[int], positions: np.ndarray) -> JointPath:
    """Straight from one pose to the next, at times after now, as told by whoever knows no more of it."""
    return JointPath(JOINT_NAMES, NOW + np.array(ms) * MS, positions)


def every(step_ms: int, path: JointPath) -> JointPath:
    """The same path, told so often."""
    stamps = np.union1d(path.stamps, np.arange(path.stamps[0], path.stamps[-1], step_ms * MS))
    return JointPath(path.names, stamps, sample_path(path, stamps))


@settings(max_examples=40, deadline=None)
@given(
    times=st.sets(st.integers(1, 10), min_size=1, max_size=5),
    left_m=st.floats(-0.4, 0.6),
    kind=st.sampled_from([ObstacleKind.STATIC, ObstacleKind.MOVING]),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_path_of_few_poses_is_decided_on_as_one_of_many(
    ur5e_checker: ArmCollisionChecker, times: set[int], left_m: float, kind: ObstacleKind, seed: int
) -> None:
    ms = [0, *(40 * time for time in sorted(times))]
    turns = np.random.default_rng(seed).uniform(-1.5, 1.5, (len(ms) - 1, 1)) * np.diff(ms)[:, None] * 1e-3
    path = through(ms, READY + TURNING * np.concatenate([[[0.0]], np.cumsum(turns, axis=0)]))
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, left_m, kind=kind)))
    few, many = (decide(ur5e_checker, told, NOW, REACTION_S) for told in (path, every(10, path)))
    assert (few.reason, few.obstacle_id, few.link) == (many.reason, many.obstacle_id, many.link)
    assert few.speed_fraction == pytest.approx(many.speed_fraction, abs=2e-3)
    assert few.distance == pytest.approx(many.distance, abs=1e-6)


@pytest.mark.parametrize("ms", [[0, 400], [0, 10, 400], [0, 390, 400]])
@pytest.mark.parametrize("kind", [ObstacleKind.STATIC, ObstacleKind.MOVING])
def test_an_arm_stops_for_what_it_would_meet_between_two_poses(
    ur5e_checker: ArmCollisionChecker, kind: ObstacleKind, ms: list[int]
) -> None:
    """Beyond what stood in its way it was farther from that than before: it went through at full speed."""
    path = through(ms, READY + TURNING * 1e-3 * np.array(ms)[:, None])
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.02, kind=kind)))
    found = decide(ur5e_checker, path, NOW, REACTION_S)
    assert (found.speed_fraction, found.reason) == (0.0, f"stopped for {kind.name}")
    assert found.distance < -0.05


@given(steps=st.lists(st.floats(0, 0.08), max_size=120))
def test_no_point_goes_farther_than_5_cm_between_poses_that_are_looked_at(steps: list[float]) -> None:
    """An arm that braked was looked at as if it went evenly, at first every 24 cm: 24 mm of a way were missed."""
    rows, gone = _picked(np.array(steps)), np.append(0.0, np.cumsum(steps))
    assert (rows[0], rows[-1]) == (0, len(steps))
    assert len(rows) >= min(5, len(steps) + 1)
    assert ((np.diff(gone[rows]) <= 0.05 + 1e-12) | (np.diff(rows) == 1)).all()


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_how_fast_an_arm_goes_counts_as_a_share_of_its_path_s_speed(
    ur5e_checker: ArmCollisionChecker, speed: float
) -> None:
    """One that goes as fast as it is let is no faster than it is told, whatever that is in rad/s; one at full is."""
    late = servo_stopping(ur5e_checker.model, stopping_table("ur5e"))

    def told(left_m: float, going: float | None) -> float:
        ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, left_m, kind=ObstacleKind.STATIC)))
        joints = None if going is None else JointSample(NOW, JOINT_NAMES, READY, going * speed * TURNING)
        return decide(ur5e_checker, ahead(speed * TURNING), NOW, REACTION_S, table=late, joints=joints).speed_fraction

    free = {left_m: told(left_m, None) for left_m in np.arange(0.06, 0.6, 0.02)}
    slowed = [left_m for left_m, share in free.items() if 0.4 < share < 0.9]
    assert slowed
    for left_m in slowed:
        assert told(left_m, free[left_m]) == free[left_m]
        assert told(left_m, 1.0) < free[left_m]


def test_an_arm_is_looked_at_until_it_stands_and_not_only_as_far_as_its_path_is_told(
    ur5e_checker: ArmCollisionChecker,
) -> None:
    """One that begins to turn as its path ends gets to what stands beside it before it can stop."""
    late = servo_stopping(ur5e_checker.model, stopping_table("ur5e"))
    course = ArmMotion(NOW, REACTION_S, 2 * TURNING, late).course(1.0)
    stands_ms = round((course.steady_s + course.braking_s) * 1e3)
    assert stands_ms > 250, "the path ends before"

    def share(told_ms: int, left_m: float) -> float:
        thing = beside_the_tool(ur5e_checker, left_m, kind=ObstacleKind.STATIC, valid_ms=(0, 1000))
        ur5e_checker.update(obstacles(thing))
        turned = READY + 2 * TURNING * np.array([[0.0], [0.0], [(told_ms - 180) * 1e-3]])
        path = through([0, 180, told_ms], turned)
        return decide(ur5e_checker, path, NOW, REACTION_S, table=late).speed_fraction

    shares = [(share(200, left_m), share(stands_ms, left_m)) for left_m in (0.12, 0.16, 0.2)]
    assert all(told == whole < 1.0 for told, whole in shares), shares


def test_no_way_is_gone_on_with_for_more_than_a_second(ur5e_checker: ArmCollisionChecker) -> None:
    """Nor in finer steps than are told: an arm without brakes would be looked at along its way for ever."""
    motion = ArmMotion(NOW, 30.0, TURNING, stopping_table("ur5e"))
    way = _until_standstill(ur5e_checker.model, ahead(TURNING), motion)
    assert way.stamps[-1] - NOW == 1200 * MS
    assert np.diff(way.stamps).max() <= 10 * MS and len(way.stamps) == 121
