"""The arm's own space is no obstacle; what is beside it, and its shadow, still is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, state_of
from hypothesis import given
from hypothesis import strategies as st

from twin_node.forecast import BaselineForecaster, Forecaster
from twin_node.forecast.grid import decode_runs
from twin_node.forecast.kernels import kernels
from twin_node.forecast.own_space import MARGIN, own_space, within, within_reference
from twin_node.robot import RobotError, forward_kinematics, place_capsules, ur_model
from twin_node.scene import Grid, JointSample, TwinState

ARM = ur_model("ur5e")
JOINTS = JointSample(0, ARM.joint_names, np.array([0.3, -1.2, 1.4, -1.8, -1.5, 0.0]), np.zeros(6))


def distances(points: np.ndarray) -> np.ndarray:
    """[n] from the surface of the arm's capsules, m, negative inside; by sampling the capsules' axes."""
    placed = place_capsules(ARM, forward_kinematics(ARM, JOINTS.positions))
    least = np.full(len(points), np.inf)
    for ends, radius in zip(placed.ends, placed.radii, strict=True):
        for share in np.linspace(0, 1, 60):
            on_axis = (1 - share) * ends[0] + share * ends[1]
            least = np.minimum(least, np.linalg.norm(points - on_axis, axis=1) - radius)
    return least


def test_every_voxel_in_the_arm_is_its_own_and_none_far_from_it() -> None:
    grid = Grid(np.array([-0.8, -0.8, -0.1]), 0.04, (40, 40, 30))
    taken = own_space(grid, ARM, JOINTS).mask()
    from_arm = distances(grid.centers(np.arange(grid.size)))
    assert taken[from_arm < 0].all()
    assert not taken[from_arm > 0.06].any()
    assert np.count_nonzero(taken) > 50


def test_every_voxel_that_the_arm_with_its_margin_touches_is_its_own() -> None:
    """One whose middle lies beside it, too: an arm is stopped by what it meets of itself."""
    grid = Grid(np.array([-0.8, -0.8, -0.1]), 0.04, (40, 40, 30))
    points = np.random.default_rng(0).uniform([-0.8, -0.8, -0.1], [0.8, 0.8, 1.1], (20_000, 3))
    near = points[distances(points) < MARGIN]
    middles_beside = distances(grid.centers(grid.indices(near))) > MARGIN
    assert own_space(grid, ARM, JOINTS).holds(grid.indices(near)).all()
    assert np.count_nonzero(middles_beside) > 10


def test_an_arm_outside_the_grid_takes_nothing() -> None:
    assert not own_space(Grid(np.array([5.0, 5.0, 5.0]), 0.05, (8, 8, 8)), ARM, JOINTS).mask().any()


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@given(st.integers(0, 2**32 - 1), st.integers(0, 6))
def test_compiled_capsules_are_the_plain_ones(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    grid = Grid(np.array([-0.4, 0.1, -0.2]), 0.03, (21, 17, 24))
    ends = rng.uniform(-1, 1, (count, 2, 3))
    ends[:, 1] = np.where(rng.uniform(size=(count, 1)) < 0.2, ends[:, 0], ends[:, 1])
    radii = rng.uniform(0.01, 0.4, count)
    assert np.array_equal(within(grid, ends, radii).words, within_reference(grid, ends, radii).words)


def test_joints_of_another_arm_are_refused() -> None:
    with pytest.raises(RobotError, match="joint values"):
        own_space(GRID, ARM, replace(JOINTS, names=tuple(f"panda_{j}" for j in range(6))))


def seen_arm(stamp: int) -> TwinState:
    """Everything that all cameras see moves, the arm among it: a mask that misses the arm wholly."""
    state = state_of(stamp, None)
    masks = tuple(np.ones_like(mask) for mask in state.moving_masks)
    return replace(state, moving_masks=masks, frames=replace(state.frames, joints=JOINTS))


def test_neither_forecast_nor_baselines_hold_the_arm_itself() -> None:
    inside = np.flatnonzero(distances(GRID.centers(np.arange(GRID.size))) < 0)
    state = seen_arm(0)
    alone = Forecaster(GRID).update(state, 0).occupancy
    assert np.isin(inside, alone.layers[0].indices).any()
    others = BaselineForecaster(GRID, arm=ARM).update(state, 0).persistence
    assert not np.isin(inside, others.layers[0].indices).any()
    assert not decode_runs(others.unknown_runs, GRID.size)[inside].any()
    assert len(others.layers[0].indices) > 0.5 * len(alone.layers[0].indices)


def test_the_arms_space_is_where_it_has_got_to_since_its_joints_were_told() -> None:
    state, speeds = seen_arm(0), np.array([2.0, 0.5, 0, 0, 0, 0])
    old = JointSample(-100_000_000, JOINTS.names, JOINTS.positions - 0.1 * speeds, speeds)
    moved_on = replace(state, frames=replace(state.frames, joints=old))
    layers = [Forecaster(GRID, arm=ARM).update(one, 0).occupancy.layers[0] for one in (state, moved_on)]
    np.testing.assert_array_equal(layers[0].indices, layers[1].indices)


def test_states_without_joints_lose_nothing() -> None:
    state = seen_arm(0)
    without = replace(state, frames=replace(state.frames, joints=None))
    one, other = (Forecaster(GRID, arm=arm).update(without, 0).occupancy for arm in (ARM, None))
    assert np.array_equal(one.layers[0].indices, other.layers[0].indices)


def test_what_all_cameras_see_on_the_arm_but_it_is_not_is_unknown_where_the_arm_is_known() -> None:
    state = state_of(0, None)
    masks = tuple(np.ones_like(mask) for mask in state.moving_masks)
    hidden = replace(state, robot_masks=masks, frames=replace(state.frames, joints=JOINTS))
    found = [Forecaster(GRID, arm=arm).update(hidden, 0) for arm in (None, ARM)]  # by masks alone, and by joints
    unknown = [decode_runs(one.occupancy.unknown_runs, GRID.size) for one in found]
    own = own_space(GRID, ARM, JOINTS).mask()
    assert not unknown[1][own].any()
    assert unknown[1][~own].all()
    assert not unknown[0].all()
    reachable = [one.hidden.reachable.mask() for one in found]
    assert np.array_equal(reachable[1], reachable[0] & ~own), "it is no hiding place"
