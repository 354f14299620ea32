"""What is carved and is no thing: specks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.hiding import HAND_M
from twin_node.forecast.parts import Parts
from twin_node.forecast.things import pieces_of
from twin_node.scene import Bool, Float64, Grid


def of_things(grid: Grid, parts: Parts) -> Bool:
    """[M] parts that hang together with so many voxels that a hand may be in them.

    Where depth ends, at the edges of what stands, single pixels measure now this and now that.
    """
    return _of_enough(grid, parts.centers, np.bincount(parts.labels, minlength=parts.count))


def of_somebody(grid: Grid, parts: Parts) -> Bool:
    """[M] parts that hang together with so many voxels that are `likely` occupied that a hand may be in these."""
    return _of_enough(grid, parts.centers, np.bincount(parts.labels[parts.likely], minlength=parts.count))


def _of_enough(grid: Grid, centers: Float64, counts: NDArray[np.int64]) -> Bool:
    """[M] parts at `centers` [M, 3] (m) that hang together with enough of the voxels that are counted [M] in each."""
    pieces = pieces_of(centers)
    enough: Bool = np.bincount(pieces, counts, minlength=1)[pieces] >= (HAND_M / grid.voxel_size) ** 3
    return enough
