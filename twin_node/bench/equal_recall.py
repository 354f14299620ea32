"""What persistence would have to block in order to find as much as a forecast does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.grid import reach_of, spread
from twin_node.forecast.score import litres_per_voxel
from twin_node.scene import Float64, Grid, UInt32

MOST_KEPT = 64
"""Layers that the volume is averaged over, evenly spread over the run."""


@dataclass(frozen=True)
class EqualRecall:
    """Persistence grown by one radius until it has the recall of the forecast, in hindsight."""

    volume_l: float
    """Mean volume of its moving voxels, litres."""
    radius_m: float
    """By which it was grown, m."""


class PersistenceLayers:
    """Keeps an even sample of the voxels that were seen to be occupied."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._kept: list[UInt32] = []
        self._stride = 1
        self._count = 0

    def add(self, indices: UInt32) -> None:
        """Takes in the voxels of one set."""
        if self._count % self._stride == 0:
            self._kept.append(indices)
        self._count += 1
        if len(self._kept) > MOST_KEPT:
            self._kept = self._kept[::2]
            self._stride *= 2

    def grown_to(self, distances: Float64, recall: float) -> EqualRecall | None:
        """Grown until `recall` of the true points lie inside, whose `distances` [n] (m) from the layers are known.

        None where even infinite growth would not do: where nothing was seen.
        """
        if len(distances) == 0 or not self._kept:
            return None
        radius = float(np.quantile(distances, recall))
        if not np.isfinite(radius):
            return None
        volumes = [self._grown(indices, radius) for indices in self._kept]
        return EqualRecall(float(np.mean(volumes)), radius)

    def _grown(self, indices: UInt32, radius: float) -> float:
        grid = self._grid
        places = np.stack(np.unravel_index(indices.astype(np.int64), grid.dims)).astype(np.int32)
        reach = np.full(len(indices), reach_of(grid, np.array([radius]))[0])
        reached = spread(grid, places, reach, np.ones(len(indices), np.bool_))
        return len(reached.indices) * litres_per_voxel(grid)
