"""Boxes that stand cut where regions of allowed contacts end: how a cover groups what stands says nothing of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.attachment import AllowedRegion
from twin_node.arm.obstacle_set import FLUSH_M
from twin_node.scene import Bool, Float64, ObstacleKind, Obstacles, ObstacleShape


def cut_at(obstacles: Obstacles, regions: Sequence[AllowedRegion], most: int) -> Obstacles:
    """The same obstacles, those that stand and reach into a region in pieces that lie inside or outside of it.

    Pieces have all of their box but its place and size. Boxes aslant and spheres stay whole, and so does everything
    where there would be more than `most` boxes: the arm then keeps away from more than it must.
    """
    pieces = _Pieces.of(obstacles)
    for region in regions:
        for axis in range(3):
            for face in (float(region.lower[axis]), float(region.upper[axis])):
                pieces = pieces.cut(region, axis, face)
    return pieces.obstacles(obstacles) if pieces.boxes <= most else obstacles


@dataclass(frozen=True)
class _Pieces:
    """What obstacles have been cut into."""

    rows: NDArray[np.intp]
    """[n] of which obstacle each is a piece, rising."""
    lower: Float64
    """[n, 3] m."""
    upper: Float64
    """[n, 3] m."""
    is_box: Bool
    """[n]."""
    may_be_cut: Bool
    """[n]."""

    @staticmethod
    def of(obstacles: Obstacles) -> _Pieces:
        """All in one piece."""
        half = obstacles.sizes / 2
        rows, is_box = np.arange(len(half)), np.asarray(obstacles.shapes == ObstacleShape.BOX)
        return _Pieces(rows, obstacles.positions - half, obstacles.positions + half, is_box, _may_be_cut(obstacles))

    @property
    def boxes(self) -> int:
        """How many are boxes."""
        return int(np.count_nonzero(self.is_box))

    def cut(self, region: AllowedRegion, axis: int, face: float) -> _Pieces:
        """With those that reach into the region in two where its face (m) on an axis crosses them."""
        crossed = (self.lower[:, axis] < face - FLUSH_M) & (self.upper[:, axis] > face + FLUSH_M) & self.may_be_cut
        crossed &= ((self.lower < region.upper) & (self.upper > region.lower)).all(axis=1)
        if not crossed.any():
            return self
        again = np.repeat(np.arange(len(crossed)), 1 + crossed)
        second = np.append(False, again[1:] == again[:-1])
        first = np.append(second[1:], False)
        pieces = _Pieces(*(of[again] for of in vars(self).values()))
        pieces.upper[first, axis] = pieces.lower[second, axis] = face
        return pieces

    def obstacles(self, whole: Obstacles) -> Obstacles:
        """As obstacles, those that are still in one piece as they were in the `whole`."""
        if len(self.rows) == len(whole.ids):
            return whole
        is_cut = np.bincount(self.rows)[self.rows] > 1
        places, sizes = whole.positions[self.rows], whole.sizes[self.rows]
        places[is_cut] = (self.lower[is_cut] + self.upper[is_cut]) / 2
        sizes[is_cut] = self.upper[is_cut] - self.lower[is_cut]
        return replace(whole.only(self.rows), positions=places, sizes=sizes)


def _may_be_cut(obstacles: Obstacles) -> Bool:
    """[n] boxes that stand, along the axes of `base_link`."""
    along = ~obstacles.quats[:, 1:].any(axis=1)
    stands = (obstacles.kinds == ObstacleKind.STATIC) & (obstacles.shapes == ObstacleShape.BOX)
    return np.asarray(stands & along)
