"""How evenly hands move: what the second differences of a course may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.course import ACCELERATION, TURN_ACCELERATION, Course
from twin_node.rig.calibrate.normal_equations import NormalEquations
from twin_node.rig.calibrate.rotations import quat_product
from twin_node.scene import Float64

USUAL, STEADIEST = 1 / 10, 1 / 30
"""Shares of the most that hands do: what they are taken for at first, so that the clocks of slow cameras are told from
the start, and the least that they are ever taken for."""

LEAST_TOLD = 6.0
"""Accelerations are told by so many second differences at least."""


@dataclass(frozen=True)
class Hands:
    """1 sigma of how a board is accelerated between control poses."""

    turning: float = USUAL * TURN_ACCELERATION
    """rad/s^2."""
    moving: float = USUAL * ACCELERATION
    """m/s^2."""

    def roughness(self, course: Course) -> Float64:
        """[B, 7] second differences of a course's control quaternions and positions, in sigmas."""
        middle = course.bends
        values = np.concatenate([course.quats, course.positions], axis=1)
        return np.asarray((values[middle - 1] - 2 * values[middle] + values[middle + 1]) * self._weights(course))

    def add_to(self, equations: NormalEquations, course: Course) -> None:
        """Adds what `roughness` says of a course to the equations of its change."""
        if not len(course.bends):
            return
        J = self._slopes(course)
        turned = J.swapaxes(1, 2)
        slopes = -(turned @ self.roughness(course)[..., None])[..., 0]
        equations.add_inner(_columns(course), turned @ J, slopes)

    def measured(self, course: Course, equations: NormalEquations) -> Hands:
        """Hands as a course shows them that these equations led to (MacKay, Bayesian Interpolation, 1992)."""
        if not len(course.bends):
            return self
        J = self._slopes(course)
        # Of a second difference that no image tells, what is left open is all that hands may do.
        open_ = np.einsum("bij,bjk,bik->bi", J, equations.inner_covariances(_columns(course)), J)
        squares = self.roughness(course) ** 2
        sigmas = []
        for sigma, most, own in (
            (self.turning, TURN_ACCELERATION, slice(4)),
            (self.moving, ACCELERATION, slice(4, 7)),
        ):
            told = 3 * len(squares) - float(open_[:, own].sum())  # a quaternion turns about three axes
            found = sigma * np.sqrt(float(squares[:, own].sum()) / max(told, LEAST_TOLD))
            sigmas.append(float(np.clip(found, STEADIEST * most, most)))
        return Hands(*sigmas)

    def _slopes(self, course: Course) -> Float64:
        """[B, 7, 18] of `roughness` by the changes of three control poses."""
        middle = course.bends
        by_neighbour = np.zeros((len(middle), 7, 3, 6))
        for place, share in enumerate((1.0, -2.0, 1.0)):
            quats = course.quats[middle + place - 1]
            for axis in range(3):
                turn = np.zeros(4)
                turn[1 + axis] = 0.5
                by_neighbour[:, :4, place, axis] = share * quat_product(quats, np.broadcast_to(turn, quats.shape))
            by_neighbour[:, 4:, place, 3:] = share * np.eye(3)
        return (by_neighbour * self._weights(course)[:, :, None, None]).reshape(len(middle), 7, 18)

    def _weights(self, course: Course) -> Float64:
        """[B, 7] what a second difference is multiplied with to be counted in sigmas."""
        sigmas = np.array([self.turning / 2] * 4 + [self.moving] * 3)
        return np.asarray(1 / (course.steps()[:, None] ** 2 * sigmas))


def _columns(course: Course) -> NDArray[np.int64]:
    """[B, 18] inner columns of the control poses about each of the course's bends."""
    columns = 6 * (course.bends[:, None, None] + np.arange(-1, 2)[:, None]) + np.arange(6)
    return np.asarray(columns.reshape(-1, 18))
