"""What is carved and is no thing: specks."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from twin_node.forecast.hiding import HAND_M
from twin_node.forecast.parts import PART_SIZE, Parts
from twin_node.forecast.things import TOGETHER, hanging_together
from twin_node.scene import Bool, Grid


def of_things(grid: Grid, parts: Parts) -> Bool:
    """[n] voxels of parts that hang together with so many that a hand may be in them.

    Where depth ends, at the edges of what stands, single pixels measure now this and now that.
    """
    pairs = cKDTree(parts.centers).query_pairs(TOGETHER * PART_SIZE, output_type="ndarray")
    pieces = hanging_together(parts.count, pairs)[parts.labels]
    fewest = (HAND_M / grid.voxel_size) ** 3
    large: Bool = (np.bincount(pieces) >= fewest)[pieces]
    return large
