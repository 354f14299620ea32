"""Paths ahead: sampling, extrapolation, and a cycle that an arm can really drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.arm import (
    ArmCollisionChecker,
    ArmError,
    CycleParameters,
    default_path,
    extrapolate,
    path_ahead,
    path_from_sample,
    sample_path,
)
from twin_node.arm.inverse import reach_down
from twin_node.arm.path import SampledPath
from twin_node.robot import UR_NAMES, RobotError, arm_model, forward_kinematics, ur_model
from twin_node.scene import JointPath, JointSample

WORKSPACES = {
    "none": None,
    "front": np.array([[0.2, -0.4, -0.05], [0.9, 0.4, 0.6]]),
    "around": np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]]),
    "far": np.array([[1.5, 1.0, 0.0], [2.5, 2.0, 2.0]]),
    "far and high": np.array([[1.5, 1.0, 0.5], [2.5, 2.0, 2.0]]),
    "behind": np.array([[-0.9, -0.4, 0.0], [-0.2, 0.4, 0.6]]),
}


@pytest.mark.parametrize("workspace", WORKSPACES.values(), ids=WORKSPACES.keys())
@pytest.mark.parametrize("name", UR_NAMES)
def test_the_default_cycle_can_be_driven(name: str, workspace: np.ndarray | None) -> None:
    model, limits = ur_model(name), CycleParameters()
    cycle = default_path(model, workspace, limits)
    q, step = cycle.template.positions, np.diff(cycle.template.stamps)[0] * 1e-9
    velocity = np.diff(q, axis=0) / step
    assert np.abs(velocity).max() <= limits.speed * 1.01
    assert np.abs(np.diff(velocity, axis=0) / step).max() <= limits.acceleration * 1.01
    np.testing.assert_array_equal(q[0], q[-1])
    assert (q >= model.lower).all()
    assert (q <= model.upper).all()
    assert forward_kinematics(model, q)[:, -1, 2, 3].min() > 0.04
    assert np.ptp(q[:, 0]) < np.pi  # from pick to place the short way
    assert np.ptp(cycle.rests, axis=1) == pytest.approx(2 * [limits.dwell_s * 1e9])
    for begin, end in cycle.rests:
        resting = np.array([cycle.at(int(stamp)) for stamp in np.linspace(begin, end, 5)])
        np.testing.assert_allclose(resting, np.broadcast_to(resting[0], resting.shape), atol=1e-12)
        assert not np.allclose(cycle.at(int(begin) - 40_000_000), resting[0], atol=1e-6)
    checker = ArmCollisionChecker(model, max_obstacles=1)
    assert min(checker.self_distance(pose).distance for pose in q[::25]) > 0


@pytest.mark.parametrize("name", UR_NAMES)
def test_rests_last_to_the_sample_wherever_the_arm_works(name: str) -> None:
    rng = np.random.default_rng(0)
    for _ in range(8):
        lower = rng.uniform([-0.5, -0.5, 0.0], [0.3, 0.3, 0.3])
        cycle = default_path(ur_model(name), np.array([lower, lower + 0.6]))
        assert np.ptp(cycle.rests, axis=1).tolist() == [400_000_000, 400_000_000]


@pytest.mark.parametrize("turns", [-1, 1])
def test_an_arm_whose_joint_is_never_near_zero_is_checked_and_driven(turns: int) -> None:
    """Poses of it were drawn from beyond its range to half a turn, which ended in a trace."""
    model = ur_model("ur5e")
    lower, upper = model.lower.copy(), model.upper.copy()
    lower[0], upper[0] = turns * 2 * np.pi - 1.5, turns * 2 * np.pi + 1.5
    model = replace(model, lower=lower, upper=upper)
    drawn = model.random_positions(np.random.default_rng(0), 100)
    assert ((drawn >= lower) & (drawn <= upper)).all()
    assert ArmCollisionChecker(model, max_obstacles=1).self_distance(drawn[0]).distance < np.inf
    q = default_path(model).template.positions
    assert ((q >= lower) & (q <= upper)).all()


@given(
    steps=st.lists(st.integers(1, 10**9), max_size=6),
    begin=st.integers(-(10**18), 2 * 10**18),
    shares=st.lists(st.floats(-0.2, 1.2), max_size=10),
)
def test_one_time_after_another_is_sampled_as_all_at_once(steps: list[int], begin: int, shares: list[float]) -> None:
    stamps = begin + np.cumsum([0, *steps], dtype=np.int64)
    positions = np.sin(np.arange(2.0 * len(stamps))).reshape(-1, 2)
    path = JointPath(("a", "b"), stamps, positions)
    lasting = int(stamps[-1] - stamps[0])
    times = np.concatenate([stamps, [begin + round(share * lasting) for share in shares]]).astype(np.int64)
    sampled = SampledPath(path)
    one_by_one = np.array([sampled.at(int(time)) for time in times])
    np.testing.assert_allclose(one_by_one, sample_path(path, times), rtol=0, atol=1e-12)


def test_where_a_path_was_asked_for_may_be_written_to() -> None:
    path = JointPath(("a",), np.array([0, 10]), np.array([[1.0], [2.0]]))
    sampled = SampledPath(path)
    for stamp in (-5, 0, 5, 10, 15):
        sampled.at(stamp)[:] = np.nan
    np.testing.assert_array_equal(path.positions, [[1.0], [2.0]])


def test_a_cycle_repeats_its_template() -> None:
    cycle = default_path(ur_model("ur5e"))
    for stamp in (0, 3, 1_234_567_891, cycle.period_ns - 1, cycle.period_ns, 7 * cycle.period_ns + 5, -1):
        expected = sample_path(cycle.template, np.array([stamp % cycle.period_ns]))[0]
        np.testing.assert_allclose(cycle.at(stamp), expected, rtol=0, atol=1e-12)


def test_the_cycle_picks_and_places_inside_the_workspace_with_the_tool_down() -> None:
    model, workspace = ur_model("ur5e"), WORKSPACES["front"]
    assert workspace is not None
    cycle = default_path(model, workspace)
    tool = forward_kinematics(model, cycle.template.positions)[:, -1]
    low = tool[tool[:, 2, 3] < tool[:, 2, 3].min() + 1e-3]
    assert (low[:, :3, 3] > workspace[0]).all()
    assert (low[:, :3, 3] < workspace[1]).all()
    np.testing.assert_allclose(low[:, :3, 2], np.tile([0, 0, -1], (len(low), 1)), atol=0.01)
    assert np.ptp(low[:, 1, 3]) > 0.3  # both ends of the cycle, left and right


@given(stamp=st.integers(0, 2**62))
@settings(max_examples=50, deadline=None)
def test_the_cycle_repeats(stamp: int) -> None:
    cycle = CYCLE
    np.testing.assert_allclose(cycle.at(stamp), cycle.at(stamp + 3 * cycle.period_ns), atol=1e-9)
    ahead = cycle.ahead(stamp)
    assert ahead.stamps[0] == stamp
    assert ahead.stamps[-1] == stamp + 200_000_000
    np.testing.assert_array_equal(ahead.positions[7], cycle.at(stamp + 70_000_000))
    np.testing.assert_array_equal(cycle.ahead(stamp, 0.5).positions[8], cycle.at(stamp + 40_000_000))
    np.testing.assert_array_equal(cycle.ahead(stamp, 0.0).positions, np.tile(cycle.at(stamp), (21, 1)))


CYCLE = default_path(ur_model("ur5e"))


def test_a_path_ahead_is_in_the_models_order_and_stands_at_its_end() -> None:
    model = ur_model("ur5e")
    names = tuple(reversed(model.joint_names))
    path = JointPath(names, np.array([0, 100_000_000]), np.array([np.zeros(6), np.arange(6.0)]))
    ahead = path_ahead(model, path, 50_000_000)
    assert ahead.names == model.joint_names
    np.testing.assert_allclose(ahead.positions[0], np.arange(6.0)[::-1] / 2)
    np.testing.assert_allclose(ahead.positions[5:], np.tile(np.arange(6.0)[::-1], (16, 1)))
    np.testing.assert_array_equal(path_ahead(model, path, 0).positions[0], np.zeros(6))
    np.testing.assert_array_equal(path_ahead(model, path, 100_000_000).positions[0], np.arange(6.0)[::-1])


@pytest.mark.parametrize(("stamp", "found"), [(100_000_001, "was over 1e-09 s before"), (-(10**9), "begins 1 s later")])
def test_a_path_that_does_not_hold_now_tells_nothing_of_the_arm(stamp: int, found: str) -> None:
    """It would seem to stand at an end of it, and closing in on nobody: so would one of another clock."""
    model = ur_model("ur5e")
    path = JointPath(model.joint_names, np.array([0, 100_000_000]), np.array([np.zeros(6), np.arange(6.0)]))
    with pytest.raises(ArmError, match=f"holds at the time that is asked for, found one that {found}; give"):
        path_ahead(model, path, stamp)


def test_extrapolation_keeps_speed_and_ranges() -> None:
    model = ur_model("ur10e")
    q = np.array([0.0, 6.2, 0.0, 0.0, 0.0, 7.0])
    qd = np.array([0.5, 1.0, 99.0, 0.0, -0.2, 0.1])
    ahead = extrapolate(model, q, qd, 1_000)
    assert ahead.stamps[0] == 1_000
    np.testing.assert_allclose(ahead.positions[0], q)
    np.testing.assert_allclose(ahead.positions[-1, [0, 3, 4]], [0.1, 0.0, -0.04])
    assert ahead.positions[-1, 1] == model.upper[1]
    assert ahead.positions[1, 2] == pytest.approx(0.99)  # faster than its rating: it is what was measured
    assert ahead.positions[-1, 2] == model.upper[2]
    np.testing.assert_allclose(ahead.positions[[0, -1], 5], [7.0, 7.02])  # beyond its range it was measured to move
    below = extrapolate(model, -q, -qd, 1_000)
    np.testing.assert_allclose(below.positions, -ahead.positions)


@given(
    start=st.floats(-6.2, 6.2), velocity=st.floats(-20.0, 20.0), age_ms=st.integers(0, 1_000), joint=st.integers(0, 5)
)
@settings(deadline=None)
def test_an_old_sample_leads_nowhere_that_the_arm_cannot_go(
    start: float, velocity: float, age_ms: int, joint: int
) -> None:
    model, at, speeds = ur_model("ur5e"), np.zeros(6), np.zeros(6)
    at[joint], speeds[joint] = np.clip(start, model.lower[joint], model.upper[joint]), velocity
    path = path_from_sample(model, JointSample(0, model.joint_names, at, speeds), age_ms * 1_000_000)
    assert (path.positions >= model.lower).all()
    assert (path.positions <= model.upper).all()
    seconds = path.stamps[:, None] * 1e-9
    assert (np.abs(path.positions - at) <= np.abs(speeds) * seconds + 1e-9).all()


@pytest.mark.parametrize("late_ns", [1_000_000_001, -1_000_000_001, 1_700_000_000 * 10**9])
def test_a_sample_of_another_time_tells_nothing_of_the_arm(late_ns: int) -> None:
    """Its joints would seem to stand at the ends of their ranges, and to close in on nobody."""
    model = ur_model("ur5e")
    with pytest.raises(
        ArmError, match=r"joints: expected them within 1 s of the time that is asked for, found some of"
    ):
        path_from_sample(model, JointSample(0, model.joint_names, np.zeros(6), np.full(6, 0.1)), late_ns)


def test_extrapolation_starts_from_the_samples_own_time_and_order() -> None:
    model = ur_model("ur5e")
    sample = JointSample(1_000, model.joint_names[::-1], np.zeros(6), np.arange(6.0) / 10)
    ahead = path_from_sample(model, sample, 1_000 + 50_000_000)
    np.testing.assert_allclose(ahead.positions[0], np.arange(6.0)[::-1] / 10 * 0.05)
    early = path_from_sample(model, sample, 1_000 - 50_000_000)  # by a clock a little behind: not where it was before
    np.testing.assert_array_equal(early.positions[0], np.zeros(6))
    with pytest.raises(RobotError, match="finite"):
        path_from_sample(model, JointSample(0, model.joint_names, np.zeros(6), np.full(6, np.inf)), 0)


@given(x=st.floats(0.3, 0.6), y=st.floats(-0.4, 0.4), z=st.floats(0.1, 0.4))
@settings(max_examples=30, deadline=None)
def test_inverse_kinematics_reaches(x: float, y: float, z: float) -> None:
    model = ur_model("ur5e")
    q = reach_down(model, np.array([x, y, z]), np.array([0.0, -1.8, 1.9, -1.7, -1.57, 0.0]))
    tool = forward_kinematics(model, q)[-1]
    np.testing.assert_allclose(tool[:3, 3], [x, y, z], atol=1e-3)
    np.testing.assert_allclose(tool[:3, 2], [0, 0, -1], atol=5e-3)


def test_an_arm_with_a_joint_that_hardly_turns_has_a_cycle_too() -> None:
    """A range as narrow as the solver's margin at its ends left no room for a start, which ended in a trace."""
    model = ur_model("ur5e")
    locked = replace(model, lower=np.append(model.lower[:5], -1e-7), upper=np.append(model.upper[:5], 1e-7))
    assert np.abs(default_path(locked).template.positions[:, 5]).max() <= 1e-7


def test_what_cannot_be_reached_or_followed_is_refused() -> None:
    model = ur_model("ur3e")
    with pytest.raises(ArmError, match="ur3e cannot put its tool there pointing down"):
        reach_down(model, np.array([2.0, 0.0, 0.2]), np.zeros(6))
    with pytest.raises(ArmError, match="expected a lower and an upper corner"):
        default_path(model, np.zeros((2, 3)))
    stamps, positions = np.array([0, 10]), np.zeros((2, 6))
    with pytest.raises(ArmError, match="strictly increasing stamps"):
        sample_path(JointPath(model.joint_names, stamps[::-1], positions), stamps)
    with pytest.raises(ArmError, match="strictly increasing stamps"):
        sample_path(JointPath(model.joint_names, np.array([0, 10, 10]), np.zeros((3, 6))), stamps)
    with pytest.raises(ArmError, match="finite angles"):
        sample_path(JointPath(model.joint_names, stamps, np.where(np.eye(2, 6) > 0, np.nan, positions)), stamps)
    with pytest.raises(ArmError, match=r"shape \(2, 6\) with at least one row"):
        sample_path(JointPath(model.joint_names, stamps, positions[:, :5]), stamps)
    with pytest.raises(ArmError, match="at least one row"):
        sample_path(JointPath(model.joint_names, stamps[:0], positions[:0]), stamps)


def test_an_arm_from_a_file_is_taken_as_fast_as_it_is_measured() -> None:
    """The wrist of a UR3e turns at 6.28 rad/s, which no made-up rating may cut."""
    rated, from_file = ur_model("ur3e"), replace(arm_model("sim/ur3e.xml"), max_velocity=np.ones(6))
    sample = JointSample(0, rated.joint_names, np.zeros(6), np.array([0, 0, 0, 0, 0, 6.2]))
    expected, found = path_from_sample(rated, sample, 0), path_from_sample(from_file, sample, 0)
    np.testing.assert_allclose(found.positions, expected.positions)
