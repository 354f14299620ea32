"""What is carved and is no thing: specks."""

from __future__ import annotations

import numpy as np

from twin_node.forecast.hiding import HAND_M
from twin_node.forecast.parts import Parts
from twin_node.forecast.things import pieces_of
from twin_node.scene import Bool, Grid


def of_things(grid: Grid, parts: Parts) -> Bool:
    """[M] parts that hang together with so many voxels that a hand may be in them.

    Where depth ends, at the edges of what stands, single pixels measure now this and now that.
    """
    pieces = pieces_of(parts.centers)
    sizes = np.bincount(pieces, np.bincount(parts.labels, minlength=parts.count), minlength=1)
    large: Bool = sizes[pieces] >= (HAND_M / grid.voxel_size) ** 3
    return large
