"""Parts of the moving space: the nodes of a rig that has images and no model yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.growth import Points
from twin_node.forecast.kernels import kernels
from twin_node.forecast.part_requests import SplitRequest
from twin_node.native_library import addresses_of
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
    def solid(self) -> Bool:
        """[M] parts that are more than rims."""
        solid: Bool = np.bincount(self.labels[self.likely], minlength=self.count) > 0
        return solid

    def cells(self, grid: Grid) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First and last voxel [M, 3] of the cells that the parts are cut by; `grid` is that of `indices`."""
        side = _side(grid)
        first = np.floor((self.centers - grid.origin) / grid.voxel_size).astype(np.int64) // side * side
        return first, first + side - 1

    @property
    def count(self) -> int:
        """M, the number of parts."""
        return len(self.centers)

    def of(self, chosen: Bool) -> Parts:
        """Those of the parts that are `chosen` [M]."""
        mine, numbers = chosen[self.labels], np.cumsum(chosen) - 1
        places = self.places.compress(mine, axis=1)
        return Parts(self.indices[mine], places, numbers[self.labels[mine]], self.likely[mine], self.centers[chosen])


def split(grid: Grid, indices: NDArray[np.int64], likely: Bool) -> Parts:
    """Parts of the voxels `indices` [n], `likely` [n] occupied: one per occupied cell of a coarser lattice.

    Compiled; `split_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return split_reference(grid, indices, likely)
    side, voxels = _side(grid), np.ascontiguousarray(indices)
    places, labels, count = (
        np.empty((3, len(indices)), np.int32),
        np.empty(len(indices), np.int64),
        np.zeros(1, np.int64),
    )
    sums = np.empty((len(indices), 4))
    addresses = addresses_of(voxels, places, labels, sums, count)
    compiled.run(SplitRequest(len(voxels), *grid.dims, side, *addresses))
    sums = sums[: count[0]]
    return Parts(indices, places, labels, likely, _middles(grid, sums[:, :3], sums[:, 3:]))


def split_reference(grid: Grid, indices: NDArray[np.int64], likely: Bool) -> Parts:
    """What `split` does."""
    side = _side(grid)
    lattice = tuple(-(-n // side) for n in grid.dims)
    places = np.stack(np.unravel_index(indices, grid.dims)).astype(np.int32)
    cells = np.ravel_multi_index(tuple(places // side), lattice)
    counts = np.bincount(cells, minlength=int(np.prod(lattice)))
    occupied = np.flatnonzero(counts)
    numbers = np.zeros(len(counts), np.int64)
    numbers[occupied] = np.arange(len(occupied))
    sums = np.stack([np.bincount(cells, axis, len(counts))[occupied] for axis in places], axis=1)
    middles = _middles(grid, sums.astype(np.float64), counts[occupied, None].astype(np.float64))
    return Parts(indices, places, numbers[cells], likely, middles)


def _side(grid: Grid) -> int:
    """Voxels along a part."""
    return max(1, round(PART_SIZE / grid.voxel_size))


def _middles(grid: Grid, sums: Float64, counts: Float64) -> Float64:
    """Means [M, 3] in metres of voxels, by the sums [M, 3] of their coordinates and their counts [M, 1]."""
    middles: Float64 = grid.origin + (sums / counts + 0.5) * grid.voxel_size
    return middles
