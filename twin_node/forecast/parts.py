"""Parts of the moving space: the nodes of a rig that has images and no model yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.growth import Points
from twin_node.scene import Bool, Float64, Grid

PART_SIZE = 0.08
"""Edge of a part, m: about as thick as a forearm, so that limbs and torso get parts of their own."""


@dataclass(frozen=True)
class Parts:
    """Moving voxels in cubes of about `PART_SIZE`."""

    indices: NDArray[np.int64]
    """[n] flat voxel indices."""
    places: NDArray[np.int32]
    """[3, n] voxel coordinates (i, j, k)."""
    labels: NDArray[np.int64]
    """[n] part of each voxel."""
    likely: Bool
    """[n] voxels that are occupied more likely than not; the others are rims that errors add."""
    centers: Float64
    """[M, 3] mean of each part's voxels, m."""

    @property
    def points(self) -> Points:
        """The voxels as growth takes them: the likely ones are cores."""
        return Points(self.places, self.labels, self.likely)

    @property
    def points_and_rims(self) -> Points:
        """The same with the rims under labels of their own: `count` more than those of their parts."""
        return Points(self.places, np.where(self.likely, self.labels, self.labels + self.count), self.likely)

    @property
    def count(self) -> int:
        """M, the number of parts."""
        return len(self.centers)


def split(grid: Grid, indices: NDArray[np.int64], likely: Bool) -> Parts:
    """Parts of the voxels `indices` [n], `likely` [n] occupied: one per occupied cell of a coarser lattice."""
    side = max(1, round(PART_SIZE / grid.voxel_size))
    lattice = tuple(-(-n // side) for n in grid.dims)
    places = np.stack(np.unravel_index(indices, grid.dims)).astype(np.int32)
    cells = np.ravel_multi_index(tuple(places // side), lattice)
    counts = np.bincount(cells, minlength=int(np.prod(lattice)))
    occupied = np.flatnonzero(counts)
    numbers = np.zeros(len(counts), np.int64)
    numbers[occupied] = np.arange(len(occupied))
    sums = np.stack([np.bincount(cells, axis, len(counts))[occupied] for axis in places], axis=1)
    centers = grid.origin + (sums / counts[occupied, None] + 0.5) * grid.voxel_size
    return Parts(indices, places, numbers[cells], likely, centers)
