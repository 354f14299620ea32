"""How evenly hands move: what the second differences of a course may be."""

from __future__ import annotations

import numpy as np

from twin_node.rig.calibrate.course import ACCELERATION, TURN_ACCELERATION, Course
from twin_node.rig.calibrate.normal_equations import NormalEquations
from twin_node.rig.calibrate.rotations import quat_product
from twin_node.scene import Float64


def roughness(course: Course) -> Float64:
    """[B, 7] second differences of a course's control quaternions and positions, in sigmas."""
    middle = course.bends
    values = np.concatenate([course.quats, course.positions], axis=1)
    return np.asarray((values[middle - 1] - 2 * values[middle] + values[middle + 1]) * _smoothness(course))


def add_smoothness(equations: NormalEquations, course: Course) -> None:
    """Adds what `roughness` says of a course to the equations of its change."""
    middle, scale = course.bends, _smoothness(course)
    if not len(middle):
        return
    by_neighbour = np.zeros((len(middle), 7, 3, 6))
    for place, share in enumerate((1.0, -2.0, 1.0)):
        quats = course.quats[middle + place - 1]
        for axis in range(3):
            turn = np.zeros(4)
            turn[1 + axis] = 0.5
            by_neighbour[:, :4, place, axis] = share * quat_product(quats, np.broadcast_to(turn, quats.shape))
        by_neighbour[:, 4:, place, 3:] = share * np.eye(3)
    J = (by_neighbour * scale[:, :, None, None]).reshape(len(middle), 7, 18)
    columns = 6 * (middle[:, None, None] + np.arange(-1, 2)[:, None]) + np.arange(6)
    turned = J.swapaxes(1, 2)
    slopes = -(turned @ roughness(course)[..., None])[..., 0]
    equations.add_inner(columns.reshape(len(middle), 18), turned @ J, slopes)


def _smoothness(course: Course) -> Float64:
    """[B, 7] what a second difference is multiplied with to be counted in sigmas."""
    sigmas = np.array([TURN_ACCELERATION / 2] * 4 + [ACCELERATION] * 3)
    return np.asarray(1 / (course.steps()[:, None] ** 2 * sigmas))
