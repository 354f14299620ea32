"""A small set of boxes that holds every occupied voxel over its whole interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.errors import ForecastError
from twin_node.forecast.grid import decode_runs
from twin_node.forecast.hiding import Hidden
from twin_node.scene import (
    Bool,
    Float64,
    Grid,
    MotionExpert,
    ObstacleKind,
    Obstacles,
    ObstacleShape,
    Occupancy,
    UInt8,
)


@dataclass(frozen=True)
class CoverParameters:
    """How many obstacles there may be. The cover gets coarser under a cap, never incomplete."""

    most_moving: int = 64
    """Largest number of MOVING obstacles per interval between horizons."""
    most_static: int = 128
    """Largest number of STATIC obstacles."""
    most_unknown: int = 64
    """Largest number of UNKNOWN obstacles, and of STATIC ones for unknown space that may be full."""
    unknown_share: float = 0.5
    """A cell counts as UNKNOWN obstacle from this share of unknown voxels on: rims of the carving are left out."""


@dataclass(frozen=True)
class Motion:
    """How the parts of the moving space move: what gives obstacles their velocity and bound."""

    centers: Float64
    """[M, 3] m."""
    velocities: Float64
    """[M, 3] m/s."""
    radii: Float64
    """[H, M] bound at each horizon, m."""
    experts: UInt8 | None = None
    """[M] values of `MotionExpert`: which has the most weight; None where nobody says."""


def cover(
    occupancy: Occupancy,
    previous: Obstacles | None = None,
    parameters: CoverParameters | None = None,
    motion: Motion | None = None,
    hidden: Hidden | None = None,
) -> Obstacles:
    """Obstacles that hold every occupied voxel of `occupancy`, whole, for as long as it is occupied.

    MOVING ones are valid from one horizon to the next and hold the voxels of both layers; STATIC and UNKNOWN ones are
    valid throughout. Each is the tight box about the voxels in one cell of a fixed lattice; ids name kind, interval and
    cell, so they stay while things move within cells. `previous` keeps the lattice from flickering between two
    sizes; `motion` gives velocities and bounds, zero without it. Unknown space is UNKNOWN where something may come out
    of it, STATIC where it may be full, and no obstacle where it is known to be empty: as `hidden` tells, all of it
    UNKNOWN without.

    Raises `ForecastError` for a cap below 1.
    """
    parameters = parameters or CoverParameters()
    _check(parameters)
    grid = occupancy.grid
    stamps = [occupancy.publish_stamp + layer.horizon_ns for layer in occupancy.layers]
    cells = [_cells(grid, layer.indices.astype(np.int64)) for layer in occupancy.layers]
    batches = []
    for interval in range(len(stamps) - 1):
        both = _united(cells[interval], cells[interval + 1])
        floor = _previous_level(previous, ObstacleKind.MOVING, interval)
        boxes = _coarsened(both, parameters.most_moving, floor)
        batches.append(_batch(grid, boxes, ObstacleKind.MOVING, interval, stamps[interval], stamps[interval + 1]))
    first, last = stamps[0], stamps[-1]
    standing = _coarsened(_cells(grid, occupancy.static.indices.astype(np.int64)), parameters.most_static, 0)
    batches.append(_batch(grid, standing, ObstacleKind.STATIC, 0, first, last))
    if hidden is None:
        unknown = decode_runs(occupancy.unknown_runs, grid.size)
        hidden = Hidden(reachable=unknown, maybe_full=np.zeros(grid.size, np.bool_))
    for kind, mask, number in (
        (ObstacleKind.UNKNOWN, hidden.reachable, 0),
        (ObstacleKind.STATIC, hidden.maybe_full, 1),
    ):
        batches.append(_batch(grid, _mostly(grid, mask, parameters), kind, number, first, last))
    return _obstacles(occupancy.stamp, batches, motion)


_SMALLEST = 4
"""Voxels along a cell of level 0; each level doubles it."""
_MANY = 4000
"""Voxels per layer above which boxes are fitted to pairs of voxels: finer ones are merged under any cap anyway."""


@dataclass(frozen=True)
class _Cells:
    """Boxes about voxels, one per occupied cell of a lattice, in voxel coordinates."""

    level: int
    cells: NDArray[np.int64]
    """[c, 3] cell coordinates."""
    lower: NDArray[np.int64]
    """[c, 3] first voxel."""
    upper: NDArray[np.int64]
    """[c, 3] last voxel."""


@dataclass(frozen=True)
class _Batch:
    """Boxes of one kind and interval."""

    ids: NDArray[np.uint32]
    kind: ObstacleKind
    lower: Float64
    upper: Float64
    valid_from: int
    valid_to: int


def _check(parameters: CoverParameters) -> None:
    for name in ("most_moving", "most_static", "most_unknown"):
        if getattr(parameters, name) < 1:
            raise ForecastError(f"{name}: expected at least 1 obstacle, found {getattr(parameters, name)}; raise it")


def _cells(grid: Grid, indices: NDArray[np.int64]) -> _Cells:
    """The finest cells that hold voxels [n]; many voxels are taken two by two by two, with boxes to match."""
    stride = 2 if len(indices) > _MANY else 1
    dims = np.array(grid.dims)
    if stride == 2:
        indices, coarse = _halved(grid, indices)
    else:
        coarse = grid.dims
    voxels = np.stack(np.unravel_index(indices, coarse), axis=1) * stride
    return _boxed(0, voxels // _SMALLEST, voxels, np.minimum(voxels + stride, dims) - 1)


def _halved(grid: Grid, indices: NDArray[np.int64]) -> tuple[NDArray[np.int64], tuple[int, int, int]]:
    """Flat indices, and size, on a lattice of half the resolution: the cells that hold any of the voxels [n]."""
    x, y, z = (-(-n // 2) for n in grid.dims)
    dense = np.zeros((2 * x, 2 * y, 2 * z), np.bool_)
    flat = np.zeros(grid.size, np.bool_)
    flat[indices] = True
    dense[: grid.dims[0], : grid.dims[1], : grid.dims[2]] = flat.reshape(grid.dims)
    dense = dense[::2] | dense[1::2]
    dense = dense[:, ::2] | dense[:, 1::2]
    return np.flatnonzero(dense[..., ::2] | dense[..., 1::2]), (x, y, z)


def _boxed(level: int, cells: NDArray[np.int64], lower: NDArray[np.int64], upper: NDArray[np.int64]) -> _Cells:
    """One box per distinct cell about the boxes (lower, upper) [n, 3] that lie in it."""
    if len(cells) == 0:
        return _Cells(level, cells, lower, upper)
    keys = (cells[:, 0] << 40) | (cells[:, 1] << 20) | cells[:, 2]
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    first = order[starts]
    return _Cells(
        level,
        cells[first],
        np.minimum.reduceat(lower[order], starts, axis=0),
        np.maximum.reduceat(upper[order], starts, axis=0),
    )


def _united(one: _Cells, other: _Cells) -> _Cells:
    return _boxed(
        one.level,
        np.concatenate([one.cells, other.cells]),
        np.concatenate([one.lower, other.lower]),
        np.concatenate([one.upper, other.upper]),
    )


def _coarsened(boxes: _Cells, most: int, at_least_level: int) -> _Cells:
    """Cells of twice the size until there are at most `most`."""
    while len(boxes.cells) > most or boxes.level < at_least_level:
        boxes = _boxed(boxes.level + 1, boxes.cells // 2, boxes.lower, boxes.upper)
    return boxes


def _mostly(grid: Grid, mask: Bool, parameters: CoverParameters) -> _Cells:
    """Cells that unknown voxels, a flat mask, mostly fill, coarse enough to be few."""
    voxels = np.stack(np.unravel_index(np.flatnonzero(mask), grid.dims), axis=1)
    level = 0
    while True:
        side = _SMALLEST << level
        lattice = [-(-n // side) for n in grid.dims]
        counts = np.bincount(np.ravel_multi_index(tuple((voxels // side).T), tuple(lattice)), minlength=1)
        full = np.flatnonzero(counts >= parameters.unknown_share * side**3)
        if len(full) <= parameters.most_unknown:
            break
        level += 1
    cells = np.stack(np.unravel_index(full, tuple(lattice)), axis=1)
    return _Cells(level, cells, cells * side, np.minimum((cells + 1) * side, np.array(grid.dims)) - 1)


def _previous_level(previous: Obstacles | None, kind: ObstacleKind, interval: int) -> int:
    """One level below the lattice of the last cover: it may get finer by one step at a time only."""
    if previous is None or len(previous.ids) == 0:
        return 0
    mine = (previous.ids >> 24) == np.uint32((int(kind) << 3) | interval)
    levels = (previous.ids[mine] >> 21) & 7
    return max(int(levels.max(initial=0)) - 1, 0)


def _batch(grid: Grid, boxes: _Cells, kind: ObstacleKind, interval: int, valid_from: int, valid_to: int) -> _Batch:
    lattice = np.array([-(-n // _SMALLEST) for n in grid.dims])
    places = (boxes.cells[:, 0] * lattice[1] + boxes.cells[:, 1]) * lattice[2] + boxes.cells[:, 2]
    ids = (((int(kind) << 3) | interval) << 24) | (boxes.level << 21) | (places & 0x1FFFFF)
    lower = grid.origin + boxes.lower * grid.voxel_size
    upper = grid.origin + (boxes.upper + 1) * grid.voxel_size
    return _Batch(ids.astype(np.uint32), kind, lower, upper, valid_from, valid_to)


def _obstacles(stamp: int, batches: list[_Batch], motion: Motion | None) -> Obstacles:
    counts = [len(batch.ids) for batch in batches]
    lower = np.concatenate([batch.lower for batch in batches])
    upper = np.concatenate([batch.upper for batch in batches])
    kinds = np.repeat([int(batch.kind) for batch in batches], counts).astype(np.uint8)
    total = len(kinds)
    quats = np.zeros((total, 4))
    quats[:, 0] = 1
    velocities, bounds = np.zeros((total, 3)), np.zeros(total)
    experts = np.full(total, MotionExpert.NO_EXPERT, np.uint8)
    moving = kinds == ObstacleKind.MOVING
    if motion is not None and len(motion.centers):
        centers = (lower + upper)[moving] / 2
        nearest = _nearest(centers, motion.centers)
        velocities[moving] = motion.velocities[nearest]
        bounds[moving] = motion.radii[-1][nearest]
        if motion.experts is not None:
            experts[moving] = motion.experts[nearest]
    return Obstacles(
        stamp=stamp,
        ids=np.concatenate([batch.ids for batch in batches]),
        kinds=kinds,
        shapes=np.full(total, ObstacleShape.BOX, np.uint8),
        positions=(lower + upper) / 2,
        quats=quats,
        sizes=upper - lower,
        velocities=velocities,
        bounds=bounds,
        valid_from=np.repeat([batch.valid_from for batch in batches], counts).astype(np.int64),
        valid_to=np.repeat([batch.valid_to for batch in batches], counts).astype(np.int64),
        experts=experts,
    )


def _nearest(points: Float64, others: Float64) -> NDArray[np.int64]:
    """Row of `others` [m, 3] nearest to each of `points` [n, 3]."""
    squared = ((points[:, None] - others[None]) ** 2).sum(axis=2)
    return np.asarray(squared.argmin(axis=1), dtype=np.int64)
