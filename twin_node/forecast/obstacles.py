"""A small set of boxes that holds every occupied voxel over its whole interval."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from twin_node.forecast.bits import Bits
from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.boxes import Boxes, fitted, mostly_full, smallest_boxes
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.grid import decode_runs
from twin_node.forecast.hiding import Hidden
from twin_node.scene import (
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
    most_static: int = 256
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
    sigmas: Float64 | None = None
    """[M] standard deviations of each component of the velocities, m/s; None where nobody says."""

    @property
    def sure_velocities(self) -> Float64:
        """[M, 3] the velocities, faster than a person's only as far as that is sure: one part's may err by as much."""
        if self.sigmas is None:
            return self.velocities
        speeds = np.linalg.norm(self.velocities, axis=1)
        sure = np.maximum(speeds - _SIGMAS * self.sigmas, np.minimum(speeds, PERSON_SPEED))
        velocities: Float64 = self.velocities * (sure / np.maximum(speeds, 1e-9))[:, None]
        return velocities


@dataclass(frozen=True)
class Sighted:
    """What was seen to move, where it was seen."""

    grid: Grid
    """That of the forecast and a rim about it."""
    indices: NDArray[np.int64]
    """[n] flat indices in this grid."""


def cover(
    occupancy: Occupancy,
    previous: Obstacles | None = None,
    parameters: CoverParameters | None = None,
    motion: Motion | None = None,
    hidden: Hidden | None = None,
    sighted: Sighted | None = None,
) -> Obstacles:
    """Obstacles that hold every occupied voxel of `occupancy`, whole, for as long as it is occupied.

    MOVING ones are valid from one horizon to the next and hold the voxels of both layers; STATIC and UNKNOWN ones are
    valid throughout. Each is the tight box about the voxels in one cell of an octree, small where that spares most
    space; ids name kind, interval and cell, so they stay while things move within cells. `previous` keeps the cover
    from flickering between two that are equally good; `motion` gives velocities and bounds, zero without it.
    Unknown space is UNKNOWN where something may come out of it, STATIC where it may be full, and no obstacle where it
    is known to be empty: as `hidden` tells, all of it UNKNOWN without. `sighted` adds, to a forecast of anything,
    MOVING obstacles that hold what it is a forecast of, valid at the evidence alone (`Obstacles.as_seen`).

    Raises `ForecastError` for a cap below 1.
    """
    parameters = parameters or CoverParameters()
    _check(parameters)
    grid = occupancy.grid
    stamps = [occupancy.publish_stamp + layer.horizon_ns for layer in occupancy.layers]
    if hidden is None:
        unknown = decode_runs(occupancy.unknown_runs, grid.size)
        hidden = Hidden(reachable=Bits.of_mask(grid.dims, unknown), maybe_full=Bits.none(grid.dims))
    batches = []

    def hold(
        boxes: Boxes, most: int, kind: ObstacleKind, interval: int, valid: tuple[int, int], within: Grid = grid
    ) -> None:
        few = fitted(within, boxes, most, _before(previous, kind, interval))
        batches.append(_batch(within, few, kind, interval, *valid))

    layers = [layer.indices for layer in occupancy.layers]
    for interval, valid in enumerate(itertools.pairwise(stamps)):
        both = smallest_boxes(grid, np.concatenate(layers[interval : interval + 2]))
        hold(both, parameters.most_moving, ObstacleKind.MOVING, interval, valid)
    if sighted is not None and any(len(indices) for indices in layers):
        seen, at = smallest_boxes(sighted.grid, sighted.indices), (occupancy.stamp, occupancy.stamp)
        hold(seen, parameters.most_moving, ObstacleKind.MOVING, _AS_SEEN, at, sighted.grid)
    throughout = stamps[0], stamps[-1]
    standing = smallest_boxes(grid, occupancy.static.indices)
    hold(standing, parameters.most_static, ObstacleKind.STATIC, 0, throughout)
    maybe_full = mostly_full(grid, hidden.maybe_full, parameters.unknown_share)
    hold(maybe_full, parameters.most_unknown, ObstacleKind.STATIC, 1, throughout)
    reachable = mostly_full(grid, hidden.reachable, parameters.unknown_share)
    hold(reachable, parameters.most_unknown, ObstacleKind.UNKNOWN, 0, throughout)
    return _obstacles(occupancy.stamp, batches, motion)


_SIGMAS = 2.0
"""Standard deviations of a velocity that a speed beyond a person's is told without: it is faster in 39 of 40 cases."""
_AS_SEEN = 7
"""Stands for an interval in the ids of what was seen: the last that they have room for."""


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


def _before(previous: Obstacles | None, kind: ObstacleKind, interval: int) -> NDArray[np.int64]:
    """[k] places of the last cover's boxes."""
    if previous is None:
        return np.zeros(0, np.int64)
    ids = previous.ids.astype(np.int64)
    places: NDArray[np.int64] = ids[ids >> 24 == (int(kind) << 3) | interval] & 0xFFFFFF
    return places


def _batch(grid: Grid, boxes: Boxes, kind: ObstacleKind, interval: int, valid_from: int, valid_to: int) -> _Batch:
    ids = (((int(kind) << 3) | interval) << 24) | boxes.places(grid)
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
        velocities[moving] = motion.sure_velocities[nearest]
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
    return np.asarray(cdist(points, others, "sqeuclidean").argmin(axis=1), dtype=np.int64)
