"""Whether an arm works where somebody looks."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.arm import beyond
from twin_node.robot import forward_kinematics, ur_model

Q = np.array([0.0, -1.5, 1.5, -1.5, -1.57, 0.0])
ARM = ur_model("ur5e").carrying(np.zeros((1, 2, 3)), np.array([0.1]))
"""Its last link is inside a sphere of 10 cm about the tool's frame."""
TOOL = forward_kinematics(ARM, Q)[-1, :3, 3]


@pytest.mark.parametrize(
    ("lower", "upper", "far"),
    [
        ([-1, -1, -1], [1, 1, 1], -0.9),
        ([-1, -1, -1], [1, 1, 0], 0.1),
        ([-1, -1, -1], [0.05, 1, 1], 0.05),
        ([0.2, 0.4, -1], [1, 1, 1], 0.5),
        ([-1, -1, 0.5], [1, 1, 1], -0.9),  # the floor is no side: a tool touches it
    ],
)
def test_an_arm_is_outside_as_far_as_what_it_carries_sticks_out(
    lower: list[float], upper: list[float], far: float
) -> None:
    assert beyond(ARM, Q, np.array([lower, upper]) + TOOL) == pytest.approx(far)
