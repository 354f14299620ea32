"""Voxel grids: the default one for a workspace, runs of indices, and dilation on packed bits."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.errors import ForecastError
from twin_node.scene import Bool, Float64, Grid, UInt32

MOST_VOXELS = 1_500_000
"""Above this many voxels two CPU cores no longer keep up with camera rate; the voxels are made larger."""

Words = NDArray[np.uint64]


def default_grid(workspace: Float64, voxel_size: float = 0.02, most_voxels: int = MOST_VOXELS) -> Grid:
    """Grid over a workspace [2, 3] (lower and upper corner, m), coarsened until it has at most `most_voxels`.

    Raises `ForecastError` for a workspace that is not finite or not lower < upper, and for a voxel size <= 0.
    """
    corners = np.asarray(workspace, dtype=np.float64)
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] < corners[1]).all():
        raise ForecastError(
            f"workspace: expected two corners [2, 3] with lower < upper in metres, found {corners.tolist()}; "
            "correct `workspace` in the rig file"
        )
    if not voxel_size > 0:
        raise ForecastError(f"voxel_size: expected more than 0 m, found {voxel_size}; 0.02 suits two CPU cores")
    extent = corners[1] - corners[0]
    size = max(voxel_size, float(np.cbrt(extent.prod() / most_voxels)))
    while np.prod(np.ceil(extent / size - 1e-9)) > most_voxels:
        size *= 1.02
    dims = np.maximum(np.ceil(extent / size - 1e-9), 1).astype(int)
    return Grid(corners[0].copy(), size, (int(dims[0]), int(dims[1]), int(dims[2])))


def encode_runs(mask: Bool) -> UInt32:
    """Runs [r, 2] (start, length) of the True entries of a flat mask [n]."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    starts, ends = edges[::2], edges[1::2]
    return np.stack([starts, ends - starts], axis=1).astype(np.uint32)


def decode_runs(runs: UInt32, size: int) -> Bool:
    """Flat mask [size] of runs [r, 2] (start, length)."""
    steps = np.zeros(size + 1, np.int32)
    np.add.at(steps, runs[:, 0].astype(np.int64), 1)
    np.add.at(steps, runs.astype(np.int64).sum(axis=1), -1)
    return np.cumsum(steps[:-1]) > 0


def pack(dense: Bool) -> Words:
    """Bits [nx, ny, w] of a dense mask [nx, ny, nz], 64 voxels along z per word, lowest bit first."""
    nx, ny, nz = dense.shape
    width = -(-nz // 64)
    if nz % 64:
        padded = np.zeros((nx, ny, width * 64), np.bool_)
        padded[:, :, :nz] = dense
        dense = padded
    words: Words = np.packbits(dense.reshape(-1), bitorder="little").view(np.uint64)
    return words.reshape(nx, ny, width)


def unpack(words: Words, nz: int) -> Bool:
    """Dense mask [nx, ny, nz] of packed bits [nx, ny, w]."""
    nx, ny, width = words.shape
    bits = np.unpackbits(words.view(np.uint8).reshape(-1), bitorder="little").view(np.bool_)
    return bits.reshape(nx, ny, width * 64)[:, :, :nz]


def grow(words: Words, radius: float) -> Words:
    """Packed bits grown by a ball: to every voxel whose centre is at most `radius` voxels from that of a set one.

    Exact. Columns along z are lengthened by each half height of the ball once, then shifted and united row by row.
    """
    reach = int(radius)
    taller = [words]
    for _ in range(reach):
        taller.append(_lengthened(taller[-1]))
    grown = np.zeros_like(words)
    for dx in range(min(reach, len(words) - 1) + 1):
        rows = np.zeros_like(words)
        for dy in range(min(int(np.sqrt(radius**2 - dx**2)), words.shape[1] - 1) + 1):
            column = taller[int(np.sqrt(max(radius**2 - dx**2 - dy**2, 0)))]
            _unite(rows[:, dy:], column[:, : words.shape[1] - dy])
            if dy:
                _unite(rows[:, :-dy], column[:, dy:])
        _unite(grown[dx:], rows[: len(words) - dx])
        if dx:
            _unite(grown[:-dx], rows[dx:])
    return grown


def _unite(to: Words, other: Words) -> None:
    np.bitwise_or(to, other, out=to)


def _lengthened(words: Words) -> Words:
    """Packed bits grown by one voxel along z, both ways."""
    longer: Words = words << np.uint64(1)
    longer |= words
    longer |= words >> np.uint64(1)
    if words.shape[2] > 1:
        longer[:, :, 1:] |= words[:, :, :-1] >> np.uint64(63)
        longer[:, :, :-1] |= words[:, :, 1:] << np.uint64(63)
    return longer


def grow_by(levels: NDArray[np.uint8], present: NDArray[np.integer]) -> Bool:
    """Union of balls: every voxel of `levels` [nx, ny, nz] with level l > 0 grows by (l - 1) / `PER_VOXEL` voxels.

    `present` [k] lists the levels that occur.
    """
    nx, ny, nz = levels.shape
    reached = np.zeros((nx, ny, -(-nz // 64)), np.uint64)
    for level in present.tolist():
        radius = (level - 1) / PER_VOXEL
        chosen = levels == level
        if not chosen.any():
            continue
        columns = cv2.reduce(chosen.view(np.uint8).reshape(nx * ny, nz), 1, cv2.REDUCE_MAX).reshape(nx, ny)
        window = _window(columns > 0, margin=int(radius))
        _unite(reached[window], grow(pack(chosen[window]), radius))
    return unpack(reached, nz)


def _window(mask: Bool, margin: int) -> tuple[slice, slice]:
    """Rows and columns of the rectangle about the True entries of a mask, and `margin` more on every side."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(0, int(rows[0]) - margin), int(rows[-1]) + margin + 1),
        slice(max(0, int(columns[0]) - margin), int(columns[-1]) + margin + 1),
    )


@dataclass(frozen=True)
class Spread:
    """Voxels reached by balls about points."""

    indices: NDArray[np.int64]
    """[n] flat indices, strictly increasing."""
    core: Bool
    """[n] True for voxels that hold a core point themselves."""


PER_VOXEL = 4
"""Units of reach in a voxel's edge."""


def reach_of(grid: Grid, radii: Float64) -> NDArray[np.uint8]:
    """Radii [n] (m) as reach in quarter voxels, rounded up: by at most a seventh, as every level costs time.

    Half a voxel's diagonal is added for the rounding of places to voxels, to all but radii of 0.
    """
    reach = PER_VOXEL * (radii / grid.voxel_size + np.where(radii > 0, _ROUNDING, 0))
    return np.asarray(_REACHES[np.minimum(np.searchsorted(_REACHES, reach - 1e-6), len(_REACHES) - 1)])


_ROUNDING = np.sqrt(3) / 2
"""How far a place is from the middle of its voxel at most, voxels."""
_REACHES = np.array(
    [*range(12), *range(12, 24, 2), *range(24, 48, 4), *range(48, 96, 8), *range(96, 241, 16)], np.uint8
)


def spread(grid: Grid, places: NDArray[np.int32], reach: NDArray[np.uint8], core_points: Bool) -> Spread:
    """Voxels of `grid` within `reach` [n] quarter voxels of voxels (i, j, k) `places` [3, n], which may lie outside it.

    `core_points` [n] says which of the points make their voxel a core.
    """
    most = int(reach.max(initial=0)) // PER_VOXEL
    upper = np.array(grid.dims, np.int32)[:, None] + most
    near = ((places >= -most) & (places < upper)).all(axis=0)
    if not near.all():
        places, reach, core_points = places[:, near], reach[near], core_points[near]
    if len(reach) == 0:
        return Spread(np.zeros(0, np.int64), np.zeros(0, np.bool_))
    low = places.min(axis=1) - most
    dims = places.max(axis=1) + most + 1 - low
    dims[2] += -dims[2] % 64  # whole words: packing need not copy
    levels = np.zeros(dims, np.uint8)
    order = np.argsort(reach, kind="stable")
    local = ((places[0] - low[0]) * dims[1] + (places[1] - low[1])) * dims[2] + (places[2] - low[2])
    levels.ravel()[local[order]] = reach[order] + 1
    present = np.flatnonzero(np.bincount(reach)) + 1
    cores = np.zeros(dims, np.bool_)
    cores.ravel()[local[core_points]] = True
    start, stop = np.maximum(low, 0), np.minimum(low + dims, grid.dims)
    inner = tuple(slice(a, b) for a, b in zip(start - low, stop - low, strict=True))
    outer = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
    reached, core = np.zeros((2, *grid.dims), np.bool_)
    reached[outer] = grow_by(levels, present)[inner]
    core[outer] = cores[inner]
    indices = np.flatnonzero(reached)
    return Spread(indices, core.ravel()[indices])
