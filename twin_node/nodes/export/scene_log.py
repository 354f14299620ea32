"""A scene edited elsewhere, back as a log that viewer, films and exports read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin_node.bag import LogWriter
from twin_node.messages import convert
from twin_node.model.parameters import ModelError
from twin_node.model.ply import cloud_from_stored, read_ply
from twin_node.nodes.topics import GAUSSIANS


def import_ply(path: Path, output: Path, stamp: int = 0) -> int:
    """Writes the Gaussians of a PLY file (3DGS layout) as one latched `/twin/gaussians`, all STATIC; returns how many.

    Colours become those of all sides, in 8 bits; `stamp` is in ns. Raises `ModelError` or `BagError` for a wrong path,
    `ModelError` for Gaussians that are nowhere, or of no size, shape or colour.
    """
    cloud = cloud_from_stored(read_ply(path))
    finite = np.isfinite(np.column_stack([cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.rgb])).all(1)
    if not finite.all():
        bad = f"{np.sum(~finite)} of {len(cloud.means)} Gaussians, the first at {int(finite.argmin())}"
        raise ModelError(f"{path}: expected finite numbers, found others in {bad}; take them out where it was made")
    with LogWriter(output) as log:
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud, stamp), stamp)
    return len(cloud.means)
