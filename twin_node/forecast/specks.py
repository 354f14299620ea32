"""What is carved and is no thing: specks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.hiding import HAND_M
from twin_node.forecast.parts import Parts
from twin_node.forecast.things import pieces_of
from twin_node.scene import Bool, Grid


def of_things(grid: Grid, parts: Parts) -> Bool:
    """[M] parts that hang together with so many voxels that a hand may be in them.

    Where depth ends, at the edges of what stands, single pixels measure now this and now that.
    """
    return _are_large(grid, pieces_of(parts.centers), np.bincount(parts.labels, minlength=parts.count))


def of_patches(grid: Grid, voxels: NDArray[np.int64]) -> Bool:
    """[n] which of the voxels, flat indices, touch one another in patches of so many that a hand may be in them."""
    places = np.stack(np.unravel_index(voxels, grid.dims), axis=1).astype(np.float64)
    return _are_large(grid, pieces_of(places, _TOUCHING), np.ones(len(voxels), np.int64))


def _are_large(grid: Grid, pieces: NDArray[np.int64], counts: NDArray[np.int64]) -> Bool:
    """[n] which belong to `pieces` [n] that hold enough voxels, by the voxels [n] of each."""
    sizes = np.bincount(pieces, counts, minlength=1)
    large: Bool = sizes[pieces] >= (HAND_M / grid.voxel_size) ** 3
    return large


_TOUCHING = 1.8
"""Voxels whose middles are no further apart, in voxels, touch at least by a corner."""
