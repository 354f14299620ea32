"""Inverse kinematics by least squares: joint angles that put the tool at a point, pointing down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.errors import ArmError
from twin_node.robot import ArmModel, forward_kinematics
from twin_node.robot.kinematics import tool_jacobian
from twin_node.scene import Float64

_AXIS_WEIGHT = 0.2
"""Metres that a tool axis turned by one radian counts as."""
_POSTURE_WEIGHT = 1e-4
"""Metres per radian away from the start: decides the tool's turn about its own axis, too weak to move its point."""
_TOLERANCE_M = 1e-3
"""Largest error of the tool's point (m), and of its axis times `_AXIS_WEIGHT`."""
_RESTARTS = 20
_DOWN = np.array([0.0, 0.0, -1.0])


def reach_down(model: ArmModel, point: NDArray[np.floating], start: NDArray[np.floating]) -> Float64:
    """Joint angles [J] (rad) within the limits that put the tool's origin at a point [3] (m, `base_link`), z down.

    The solution next to `start` [J] is preferred; other starts are tried only where that one fails. Raises `ArmError`
    where the point is out of reach.
    """
    generator = np.random.default_rng(0)
    seed = np.clip(np.asarray(start, dtype=np.float64), model.lower, model.upper)
    for _ in range(_RESTARTS):
        angles = _descend(model, np.asarray(point, dtype=np.float64), seed)
        if np.abs(_tool_error(model, angles, point)).max() < _TOLERANCE_M:
            return angles
        seed = model.random_positions(generator, 1)[0]
    reachable = float(np.linalg.norm(model.origins[:, :3, 3], axis=1).sum())
    raise ArmError(
        f"point {np.round(point, 3).tolist()}: {model.name} cannot put its tool there pointing down (reach at most "
        f"{reachable:.2f} m from base_link); choose a nearer point or a larger arm"
    )


def _descend(model: ArmModel, point: Float64, seed: Float64) -> Float64:
    from scipy.optimize import least_squares  # loads slowly, and most processes that have an arm never ask

    def residual(q: Float64) -> Float64:
        return np.concatenate([_tool_error(model, q, point), _POSTURE_WEIGHT * (q - seed)])

    def jacobian(q: Float64) -> Float64:
        poses = forward_kinematics(model, q)
        twist = tool_jacobian(poses)
        axis = poses[-1, :3, 2]
        turned = np.cross(twist[3:].T, axis).T
        return np.concatenate([twist[:3], _AXIS_WEIGHT * turned, _POSTURE_WEIGHT * np.eye(model.joints)])

    margin = np.minimum(1e-6, (model.upper - model.lower) / 2)  # the solver wants a start strictly inside the limits
    inside = np.clip(seed, model.lower + margin, model.upper - margin)
    found: Float64 = least_squares(residual, inside, jacobian, bounds=(model.lower, model.upper)).x
    return found


def _tool_error(model: ArmModel, q: Float64, point: NDArray[np.floating]) -> Float64:
    tool = forward_kinematics(model, q)[-1]
    return np.concatenate([tool[:3, 3] - point, _AXIS_WEIGHT * (tool[:3, 2] - _DOWN)])
