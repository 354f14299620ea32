"""What persistence would have to block in order to find as much as a forecast does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin_node.forecast.comparison import Truth
from twin_node.forecast.growth import Points, exact_reach_of, spread
from twin_node.forecast.score import MOST_POINTS, litres_per_voxel
from twin_node.scene import Float64, Grid

MOST_KEPT = 64
"""Sets that recall and volume are averaged over, evenly spread over the run."""


@dataclass(frozen=True)
class EqualRecall:
    """Persistence grown by one radius until it has the recall of the forecast, in hindsight."""

    volume_l: float
    """Mean volume of its moving voxels, litres."""
    radius_m: float
    """By which it was grown, m."""


class PersistenceGrowth:
    """Keeps an even sample of what was seen to move, and what turned out to be occupied when the forecast came due."""

    def __init__(self, grid: Grid, truth: Truth) -> None:
        self._grid = grid
        self._truth = truth
        self._kept: list[_Kept] = []
        self._stride = 1
        self._count = 0

    def add(self, places: NDArray[np.int32], valid_at: int) -> None:
        """Takes in the voxels (i, j, k) `places` [3, n] of one set, in the grid or beside it, due at a stamp."""
        if self._count % self._stride == 0:
            self._kept.append(_Kept(places, valid_at))
        self._count += 1
        if len(self._kept) > MOST_KEPT:
            self._kept = self._kept[::2]
            self._stride *= 2

    def grown_to(self, recall: float) -> EqualRecall | None:
        """Grown until `recall` of the true points lie inside; None without such points, or with nothing to grow."""
        distances = [self._distances(kept) for kept in self._kept]
        all_of_them = np.concatenate([np.zeros(0), *distances])
        if len(all_of_them) == 0:
            return None
        radius = float(np.quantile(all_of_them, recall, method="higher"))
        if not np.isfinite(radius):
            return None
        return EqualRecall(float(np.mean([self._volume_l(kept.places, radius) for kept in self._kept])), radius)

    def _distances(self, kept: _Kept) -> Float64:
        """Distances [m] in metres from true points in the grid to the nearest voxel's centre, 0 in the same voxel."""
        points = self._truth.points(kept.valid_at)
        if points is None:
            return np.zeros(0)
        grid = self._grid
        points = points[np.isfinite(points).all(axis=1)]
        points = points[grid.indices(points) >= 0]
        points = points[:: -(-len(points) // MOST_POINTS) or 1]
        if kept.places.shape[1] == 0:
            return np.full(len(points), np.inf)
        centers = grid.origin + (kept.places.T + 0.5) * grid.voxel_size
        distances, nearest = cKDTree(centers).query(points)
        same = (np.abs(points - centers[nearest]) <= grid.voxel_size / 2).all(axis=1)
        return np.where(same, 0, distances)

    def _volume_l(self, places: NDArray[np.int32], radius: float) -> float:
        count = places.shape[1]
        points = Points(places, np.zeros(count, np.int64), np.ones(count, np.bool_))
        reach = exact_reach_of(self._grid, np.array([[radius]]))
        (reached,) = spread(self._grid, points, np.zeros((1, 1, 3), np.int32), reach)
        return len(reached.indices) * litres_per_voxel(self._grid)


@dataclass(frozen=True)
class _Kept:
    """What one set showed, and when its forecast comes due."""

    places: NDArray[np.int32]
    valid_at: int
