"""Voxel grids: the default one for a workspace, and runs of indices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.errors import ForecastError
from twin_node.ranges import Range, check_ranges
from twin_node.scene import Bool, Float64, Grid, UInt32, read_only

MOST_VOXELS = 1_500_000
"""Above this many voxels two CPU cores no longer keep up with camera rate; the voxels are made larger."""
LARGEST_VOXEL_M = 1.0
"""Larger ones hold a person and the arm at once, m: who gives more means millimetres."""


@dataclass(frozen=True)
class GridParameters:
    """The voxels that occupancy is reported on."""

    voxel_size: float = 0.02
    """Edge of a voxel, m; longer where it would take more than 1.5 million: two CPU cores follow no more."""

    def __post_init__(self) -> None:
        """Raises `ForecastError` for a size that none is, or that tells nothing."""
        check_ranges(self, ForecastError, "grid: ", voxel_size=Range(0, LARGEST_VOXEL_M, above=True))


def default_grid(workspace: Float64, voxel_size: float = 0.02) -> Grid:
    """Grid over a workspace [2, 3] (lower and upper corner, m), coarsened until it has at most `MOST_VOXELS`.

    Raises `ForecastError` for a workspace that is not finite, not lower < upper, or too large for voxels that tell
    anything, and for a voxel size that is none.
    """
    corners = np.asarray(workspace, dtype=np.float64)
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] < corners[1]).all():
        raise ForecastError(
            f"workspace: expected two corners [2, 3] with lower < upper in metres, found {corners.tolist()}; "
            "correct `workspace` in the rig file"
        )
    if not 0 < voxel_size <= LARGEST_VOXEL_M:
        raise ForecastError(
            f"voxel_size: expected more than 0 and at most {LARGEST_VOXEL_M:g} m, found {voxel_size:g}; 0.02 suits two "
            "CPU cores"
        )
    extent = corners[1] - corners[0]
    size = max(voxel_size, float(np.cbrt(extent.prod() / MOST_VOXELS)))
    while np.prod(np.ceil(extent / size - 1e-9)) > MOST_VOXELS:
        size *= 1.02
    if size > LARGEST_VOXEL_M:
        across = " x ".join(f"{side:g}" for side in extent)
        raise ForecastError(
            f"workspace: expected one in metres that {MOST_VOXELS} voxels of at most {LARGEST_VOXEL_M:g} m fill, found "
            f"{across} m; correct `workspace` in the rig file: divide millimetres by 1000"
        )
    dims = np.maximum(np.ceil(extent / size - 1e-9), 1).astype(int)
    return Grid(read_only(corners[0].copy()), size, (int(dims[0]), int(dims[1]), int(dims[2])))


def encode_runs(mask: Bool) -> UInt32:
    """Runs [r, 2] (start, length) of the True entries of a flat mask [n]."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    starts, ends = edges[::2], edges[1::2]
    return np.stack([starts, ends - starts], axis=1).astype(np.uint32)


def decode_runs(runs: UInt32, size: int) -> Bool:
    """Flat mask [size] of runs [r, 2] (start, length), disjoint and rising.

    Raises `ForecastError` for runs that are neither, or that reach beyond the mask.
    """
    edges = np.zeros(2 * len(runs) + 2, np.int64)
    edges[1:-1:2] = runs[:, 0]
    edges[2:-1:2] = runs.astype(np.int64).sum(axis=1)
    edges[-1] = size
    lengths = np.diff(edges)
    if lengths.min() < 0:
        raise ForecastError(
            f"runs of unknown voxels: expected disjoint ones, rising, of {size} voxels, found others; check who "
            "publishes the occupancy"
        )
    mask: Bool = np.repeat(np.arange(len(lengths)) % 2 == 1, lengths)
    return mask
