"""What flying things meet: where they will land, and for how long they are sure to touch nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.bits import Bits
from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.experts import GRAVITY
from twin_node.forecast.parts import PART_SIZE
from twin_node.forecast.things import Whole
from twin_node.scene import Bool, Float64, Grid


@dataclass(frozen=True)
class Landing:
    """What M parts meet on their way, if they are of what falls."""

    floors: Float64
    """[M] heights (m) that the middles do not get below: what stands where the lowest of the thing first comes down on
    it, or the grid's bottom, below which is a table or the floor. -inf where it comes down on neither as far as one
    looks ahead, and for what does not fall."""
    clear_s: Float64
    """[M] s for which the thing touches neither these nor what else moves, as far as one looks ahead; 0 for what is not
    seen to fall."""

    @classmethod
    def none(cls, count: int) -> Landing:
        """Of `count` parts of nothing that falls."""
        return cls(np.full(count, -np.inf), np.zeros(count))


def landing_of(
    grid: Grid, stands: Bits, centers: Float64, solid: Bool, whole: Whole, own: Bits | None = None
) -> Landing:
    """What parts at `centers` [M, 3] (m) meet.

    `stands` and `own`, the arm: masks of the grid; `solid` [M]: parts that are more than rims.
    """
    landing = Landing.none(len(centers))
    rows = np.flatnonzero(whole.falling)
    if len(rows) == 0:
        return landing
    velocities, above = whole.velocities[rows], whole.above[rows]
    fastest = float(np.linalg.norm(velocities, axis=1).max()) - GRAVITY[2] * _AHEAD_S
    times = np.linspace(0, _AHEAD_S, 2 + int(fastest * _AHEAD_S / grid.voxel_size))
    drops = times[:, None, None] * velocities + times[:, None, None] ** 2 / 2 * GRAVITY
    way = centers[rows] - above[:, None] * _UP + drops
    lands = _held(grid, stands, way) & ~_held(grid, stands, way + grid.voxel_size * _UP)
    first = lands.argmax(axis=0)
    height = way[first, np.arange(len(rows)), 2] - grid.origin[2]
    top = grid.origin[2] + grid.voxel_size * np.ceil(height / grid.voxel_size)
    landing.floors[rows] = np.where(lands.any(axis=0), top + above, -np.inf)
    lands &= velocities[:, 2] + times[:, None] * GRAVITY[2] < 0
    things, thing_of = np.unique(velocities, axis=0, return_inverse=True)  # parts of a thing have one
    for thing, velocity in enumerate(things):
        mine = np.flatnonzero(thing_of.reshape(-1) == thing)
        body = mine[solid[rows[mine]]]
        if len(body) and whole.seen_falling[rows[mine[0]]]:
            fall = _Fall(times, drops[:, body[0]], centers[rows[body]], above[body])
            others = solid.copy()
            others[rows[body]] = False
            strikes = fall.strikes(grid, stands if own is None else stands | own)
            until = fall.until(lands[:, body].any(axis=1) | strikes | fall.nears(centers[others]))
            speed = max(float(np.linalg.norm(velocity + until * GRAVITY)), _SLOW)
            landing.clear_s[rows[mine]] = max(until - _OFF * grid.voxel_size / speed, 0.0)
    return landing


@dataclass(frozen=True)
class _Fall:
    """The way of a thing of n parts."""

    times: Float64
    """[T] s."""
    drops: Float64
    """[T, 3] by which it has moved then, m."""
    centers: Float64
    """[n, 3] of its parts now, m."""
    above: Float64
    """[n] m, by which these are above the lowest of it."""

    def strikes(self, grid: Grid, mask: Bits) -> Bool:
        """[T] whether it comes into what a mask has: with all of it while it comes down, and with its upper half while
        it rises, for then its lower one comes off what it lay on, or over an edge.

        Each part is looked at from half of one above its middle to as far below, voxel by voxel: a table top is one
        voxel high.
        """
        half = PART_SIZE / 2 / grid.voxel_size
        voxels = np.arange(-np.floor(half), np.ceil(half) + 1)
        below = np.minimum(grid.voxel_size * voxels[:, None], self.above)
        points = (self.centers - below[..., None] * _UP).reshape(-1, 3)
        held = _held(grid, mask, points + self.drops[:, None])
        enters = held & ~np.concatenate([held[:1], held[:-1]])  # what it flies through now it does not run into
        is_upper = points[:, 2] >= self.centers[:, 2].mean()
        comes_down = np.diff(self.drops[:, 2], prepend=0.0) < 0
        return np.asarray((enters & (is_upper | comes_down[:, None])).any(axis=1))

    def nears(self, others: Float64) -> Bool:
        """[T] whether one of other parts that move, at `others` [m, 3] (m) now, may be as near as to touch it."""
        middle = self.centers.mean(axis=0)
        size = float(np.linalg.norm(self.centers - middle, axis=1).max()) + 3 * PART_SIZE / 2
        ways = np.linalg.norm((middle + self.drops)[:, None] - others, axis=2)
        return np.asarray((ways < size + PERSON_SPEED * self.times[:, None]).any(axis=1))

    def until(self, meets: Bool) -> float:
        """The first time when it meets something, by `meets` [T], s; the last one where it never does."""
        return float(self.times[meets.argmax() if meets.any() else -1])


def _held(grid: Grid, mask: Bits, points: Float64) -> Bool:
    """[T, n] whether a mask has the voxels at points [T, n, 3] (m), or they lie below the grid: in a table or floor."""
    indices = grid.indices(points.reshape(-1, 3)).reshape(points.shape[:2])
    held: Bool = (indices >= 0) & mask.holds(np.maximum(indices, 0)) | (points[..., 2] < grid.origin[2])
    return held


_AHEAD_S = 0.4
"""How far ahead it is looked what a thing meets, s: the last horizon and a large latency."""
_OFF = 3.0
"""By so many voxels surfaces and the thing's own may be off."""
_SLOW = 0.5
"""Slower than this (m/s) nothing falls for long."""
_UP = np.array([0.0, 0.0, 1.0])
