"""Forward kinematics and Jacobian of a serial arm, in batches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import cross
from twin_node.robot.model import ArmModel
from twin_node.scene import Float64


@dataclass(frozen=True)
class PlacedCapsules:
    """An arm's capsules where its joints put them, in `base_link`; the leading dimensions are those of the joints."""

    ends: Float64
    """[..., C, 2, 3] m."""
    radii: Float64
    """[C] m."""
    links: NDArray[np.int64]
    """[C] index of the link that carries each."""


def forward_kinematics(model: ArmModel, q: NDArray[np.floating]) -> Float64:
    """Poses [..., J + 1, 4, 4] of the links in `base_link` at joint angles [..., J] (rad), from `base_link` itself on.

    Raises `RobotError` for a wrong number of angles or one that is not finite.
    """
    angles = model.check_positions(q)
    joint = np.zeros((*angles.shape, 4, 4))
    joint[..., 0, 0] = joint[..., 1, 1] = np.cos(angles)
    joint[..., 1, 0] = np.sin(angles)
    joint[..., 0, 1] = -joint[..., 1, 0]
    joint[..., 2, 2] = joint[..., 3, 3] = 1
    steps = model.origins @ joint
    poses = np.empty((*angles.shape[:-1], model.joints + 1, 4, 4))
    poses[..., 0, :, :] = np.eye(4)
    for j in range(model.joints):
        poses[..., j + 1, :, :] = poses[..., j, :, :] @ steps[..., j, :, :]
    return poses


def place_capsules(model: ArmModel, poses: Float64) -> PlacedCapsules:
    """The arm's capsules at link poses [..., J + 1, 4, 4] in `base_link`."""
    capsules = model.capsules
    carried = poses[..., capsules.links, :, :]
    ends = capsules.ends @ np.swapaxes(carried[..., :3, :3], -1, -2) + carried[..., None, :3, 3]
    return PlacedCapsules(ends, capsules.radii, capsules.links)


def tool_jacobian(poses: Float64) -> Float64:
    """Geometric Jacobian [6, J] of the last link's origin in `base_link`: rows are m/rad, then rad/rad.

    `poses` [J + 1, 4, 4] as `forward_kinematics` gives them.
    """
    axes = poses[1:, :3, 2]
    arms = poses[-1, :3, 3] - poses[1:, :3, 3]
    return np.concatenate([cross(axes, arms).T, axes.T])
