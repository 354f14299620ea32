"""How the parts of the moving space move, and which of them boxes about it hold."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.nearest import nearest_one
from twin_node.scene import Bool, Float64, UInt8

_SIGMAS = 2.0
"""Standard deviations of a velocity that a speed beyond a person's is told without: it is faster in 39 of 40 cases."""
_STEEP_M = 1e-9
"""Ways are taken for no shorter along an axis, m."""


class Held(NamedTuple):
    """Rows [b] of the parts that boxes get their numbers of."""

    nearest: NDArray[np.int64]
    """To the box's middle."""
    fastest: NDArray[np.int64]
    """Of those that the box holds and that are surely faster than people, and the nearest one."""


@dataclass(frozen=True)
class PartMotion:
    """How the parts of the moving space move: what gives obstacles their velocity and bound."""

    centers: Float64
    """[M, 3] m."""
    velocities: Float64
    """[M, 3] m/s."""
    radii: Float64
    """[H, M] bound at each horizon, m."""
    experts: UInt8 | None = None
    """[M] values of `MotionExpert`: which has the most weight; None where nobody says."""
    sigmas: Float64 | None = None
    """[M] standard deviations of each component of the velocities, m/s; None where nobody says."""
    between: tuple[NDArray[np.int64], ...] = ()
    """Flat indices per interval of what fast parts pass through from one horizon to the next; empty: no part is so fast
    that the layers would not hold it."""
    displacements: Float64 | None = None
    """[H, M, 3] where the parts are led at each horizon, m; None: nowhere."""

    @cached_property
    def sure_velocities(self) -> Float64:
        """[M, 3] the velocities, faster than a person's only as far as that is sure: one part's may err by as much."""
        if self.sigmas is None:
            return self.velocities
        speeds = np.linalg.norm(self.velocities, axis=1)
        sure = np.maximum(speeds - _SIGMAS * self.sigmas, np.minimum(speeds, PERSON_SPEED))
        velocities: Float64 = self.velocities * (sure / np.maximum(speeds, 1e-9))[:, None]
        return velocities

    def held(self, interval: int | None, lower: Float64, upper: Float64) -> Held:
        """Which parts boxes, given by their corners [b, 3] (m), hold from one horizon to the next, or now (None).

        A box may hold several, and one that goes far is elsewhere by then than now.
        """
        begin, end = self.centers, self.centers
        if interval is not None and self.displacements is not None:
            begin, end = self.centers + self.displacements[interval], self.centers + self.displacements[interval + 1]
        nearest = nearest_one((lower + upper) / 2, end, np.inf).rows
        speeds = np.linalg.norm(self.sure_velocities, axis=1)
        fast = np.flatnonzero(speeds > PERSON_SPEED)
        if len(fast) == 0:
            return Held(nearest, nearest)
        fast = fast[np.argsort(speeds[fast], kind="stable")]
        passes = _pass_through(lower, upper, begin[fast], end[fast])
        last = fast[len(fast) - 1 - passes[:, ::-1].argmax(axis=1)]
        is_faster = passes.any(axis=1) & (speeds[last] > speeds[nearest])
        return Held(nearest, np.where(is_faster, last, nearest))


def _pass_through(lower: Float64, upper: Float64, begin: Float64, end: Float64) -> Bool:
    """[b, n] which straight ways, from points to points [n, 3], share a point with which boxes (corners [b, 3])."""
    way = end - begin
    way = np.where(np.abs(way) > _STEEP_M, way, _STEEP_M)
    shares = (lower[:, None] - begin) / way, (upper[:, None] - begin) / way
    enters, leaves = np.minimum(*shares).max(axis=-1), np.maximum(*shares).min(axis=-1)
    return np.asarray(np.maximum(enters, 0) <= np.minimum(leaves, 1))
