"""What persistence would have to block in order to find as much as a forecast does."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin_node.forecast.comparison import Truth
from twin_node.forecast.growth import PER_VOXEL, REACHES, Points, spread
from twin_node.forecast.score import litres_per_voxel
from twin_node.scene import Float64, Grid

MOST_KEPT = 64
"""Sets that recall and volume are averaged over, evenly spread over the run."""


@dataclass(frozen=True)
class EqualRecall:
    """Persistence grown by one radius until it has the recall of the forecast, in hindsight."""

    volume_l: float
    """Mean volume of its moving voxels, litres."""
    radius_m: float
    """By which it was grown, from middle to middle of voxels, m."""


class PersistenceGrowth:
    """Keeps an even sample of what was seen to move, and what turned out to be occupied when the forecast came due."""

    def __init__(self, grid: Grid, truth: Truth) -> None:
        self._grid = grid
        self._truth = truth
        self._waiting: deque[_Due] = deque()
        self._kept: list[_Kept] = []
        self._stride = 1
        self._count = 0

    def add(self, places: NDArray[np.int32], evidence: int, valid_at: int) -> None:
        """Takes in the voxels (i, j, k) `places` [3, n] that one set shows, in the grid or beside it, and when they are
        due, ns."""
        self._waiting.append(_Due(places, evidence, valid_at))

    def settle(self, stamp: int) -> None:
        """Asks the truth about the sets that are due by a stamp, ns: later it may no longer know."""
        while self._waiting and self._waiting[0].valid_at <= stamp:
            due = self._waiting.popleft()
            if self._count % self._stride == 0:
                self._kept.append(_Kept(due.places, self._levels(due)))
            self._count += 1
            if len(self._kept) > MOST_KEPT:
                self._kept = self._kept[::2]
                self._stride *= 2

    def grown_to(self, recall: float) -> EqualRecall | None:
        """Grown as little as leaves `recall` of the true points inside, all of those settled weighed alike.

        None without such points, or with nothing to grow that reaches so many.
        """
        levels = np.sort(np.concatenate([np.zeros(0), *(kept.levels for kept in self._kept)]))
        if len(levels) == 0:
            return None
        level = float(levels[max(math.ceil(recall * len(levels) - 1e-6), 1) - 1])
        if level > REACHES[-1]:
            return None
        volume = float(np.mean([self._volume_l(kept.places, int(level)) for kept in self._kept]))
        return EqualRecall(volume, level / PER_VOXEL * self._grid.voxel_size)

    def _levels(self, due: _Due) -> Float64:
        """Quarter voxels [m] that `spread` must reach to hold each true point in the grid."""
        points = self._truth.points(due.valid_at, due.evidence)
        if points is None:
            return np.zeros(0)
        indices = self._grid.indices(points[np.isfinite(points).all(axis=1)])
        true = np.stack(np.unravel_index(indices[indices >= 0], self._grid.dims), axis=1)
        if due.places.shape[1] == 0:
            return np.full(len(true), np.inf)
        levels: Float64 = np.ceil(PER_VOXEL * cKDTree(due.places.T).query(true)[0] - 1e-6)
        return levels

    def _volume_l(self, places: NDArray[np.int32], level: int) -> float:
        count = places.shape[1]
        points = Points(places, np.zeros(count, np.int64), np.ones(count, np.bool_))
        (reached,) = spread(self._grid, points, np.zeros((1, 1, 3), np.int32), np.array([[level]], np.uint16))
        return len(reached.indices) * litres_per_voxel(self._grid)


@dataclass(frozen=True)
class _Due:
    """What one set showed, and when its forecast comes due."""

    places: NDArray[np.int32]
    evidence: int
    valid_at: int


@dataclass(frozen=True)
class _Kept:
    """What one set showed, and how far it must grow to hold what turned out to be occupied."""

    places: NDArray[np.int32]
    levels: Float64
    """[m] quarter voxels, per true point."""
