"""Joints that are measured beyond the range that their arm's file gives them: they turn there all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from obstacle_sets import MS, NOW, Thing, obstacles

from twin_node.arm import ArmCollisionChecker, decide, extrapolate, path_from_sample
from twin_node.arm.path import go_on
from twin_node.robot import ArmModel, forward_kinematics, ur_model
from twin_node.scene import JointPath, JointSample, ObstacleKind

HALF_A_TURN = replace(ur_model("ur5e"), lower=np.full(6, -np.pi), upper=np.full(6, np.pi))
IN_DEGREES = replace(ur_model("ur5e"), lower=np.full(6, -np.pi / 180), upper=np.full(6, np.pi / 180))
"""As MuJoCo reads a file that gives radians and does not say so: it takes them for degrees."""
REACHING = np.array([0.0, -1.0, 1.2, -1.7, -1.57, 0.2])
TURNING = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("model", "pan"), [(HALF_A_TURN, 4.0), (HALF_A_TURN, np.pi + 0.03), (IN_DEGREES, 0.3)], ids=["wrap", "near", "file"]
)
def test_an_arm_beyond_the_range_of_a_file_is_not_taken_to_stand(model: ArmModel, pan: float, sign: int) -> None:
    """A driver may count angles from 0 to a full turn, or the file be wrong. It was told to go on at full speed."""
    free = replace(model, lower=np.full(6, -np.inf), upper=np.full(6, np.inf))
    q = np.append(sign * pan, REACHING[1:])
    in_its_way = forward_kinematics(free, q + sign * 0.42 * TURNING)[-1]
    fraction = {}
    for arm in (model, free):
        checker = ArmCollisionChecker(arm)
        path = path_from_sample(arm, JointSample(NOW, arm.joint_names, q, sign * TURNING), NOW)
        checker.update(obstacles(Thing(tuple(in_its_way[:3, 3]), kind=ObstacleKind.STATIC)))
        decision = decide(checker, path, NOW, 0.2)
        fraction[arm is model] = decision.speed_fraction
        assert "STATIC" in decision.reason
    assert 0 < fraction[True] == fraction[False] < 1


def test_a_joint_at_the_end_of_its_range_comes_no_further() -> None:
    for beyond_rad in (0.0, 0.005):
        q = HALF_A_TURN.upper + beyond_rad
        np.testing.assert_array_equal(extrapolate(HALF_A_TURN, q, np.ones(6), NOW).positions, np.tile(q, (21, 1)))
        np.testing.assert_array_equal(extrapolate(HALF_A_TURN, -q, -np.ones(6), NOW).positions, np.tile(-q, (21, 1)))


def test_a_joint_beyond_its_range_comes_back_into_it_and_goes_on_to_its_other_end() -> None:
    model = replace(HALF_A_TURN, lower=HALF_A_TURN.upper - 0.1)
    ahead = extrapolate(model, HALF_A_TURN.upper + 0.05, np.full(6, -1.0), NOW)
    np.testing.assert_allclose(ahead.positions[[0, 10, -1], 0] - np.pi, [0.05, -0.05, -0.1])


def test_a_path_that_ends_beyond_the_range_goes_on_there() -> None:
    path = JointPath(HALF_A_TURN.joint_names, np.array([NOW, NOW + 100 * MS]), np.array([[4.0] * 6, [4.1] * 6]))
    np.testing.assert_allclose(go_on(HALF_A_TURN, path, 200 * MS).positions[-1], 4.3)
