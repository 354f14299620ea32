"""A small set of boxes that holds every occupied voxel over its whole interval."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Bits
from twin_node.forecast.covering import Covers, Share, Wanted, covers
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.grid import decode_runs
from twin_node.forecast.hiding import Hidden
from twin_node.forecast.part_motion import PartMotion
from twin_node.forecast.sighting import Sighted, Spreading
from twin_node.ranges import Range, check_ranges
from twin_node.scene import (
    HORIZONS_NS,
    Float64,
    Grid,
    MotionExpert,
    ObstacleKind,
    Obstacles,
    ObstacleShape,
    Occupancy,
    UInt32,
)


@dataclass(frozen=True)
class CoverParameters:
    """How many obstacles there may be. The cover gets coarser under a cap, never incomplete."""

    most_moving: int = 64
    """Largest number of MOVING obstacles per interval between horizons, and of those about rims of what was seen."""
    most_seen: int = 128
    """Largest number of MOVING obstacles about what was seen to move: the more, the closer the arm may pass it."""
    most_static: int = 256
    """Largest number of STATIC obstacles."""
    most_unknown: int = 64
    """Largest number of UNKNOWN obstacles, and of UNSEEN ones."""
    unknown_share: float = 0.5
    """A cell counts as UNKNOWN or UNSEEN from this share of unknown voxels on: rims of the carving are left out."""

    def __post_init__(self) -> None:
        """Raises `ForecastError` for no obstacles, and for more than anyone can look at."""
        some = Range(1, 100_000)
        share = Range(0, 1, above=True)
        check_ranges(
            self,
            ForecastError,
            "obstacles: ",
            most_moving=some,
            most_seen=some,
            most_static=some,
            most_unknown=some,
            unknown_share=share,
        )

    @property
    def most(self) -> int:
        """Largest number of obstacles in all: those that move once per interval, and once more where they were seen."""
        return self.most_moving * len(HORIZONS_NS) + self.most_seen + self.most_static + 2 * self.most_unknown


def cover(
    occupancy: Occupancy,
    previous: Obstacles | None = None,
    parameters: CoverParameters | None = None,
    motion: PartMotion | None = None,
    hidden: Hidden | None = None,
    sighted: Sighted | None = None,
) -> Obstacles:
    """Obstacles that hold every occupied voxel of `occupancy`, whole, for as long as it is occupied.

    MOVING ones are valid from one horizon to the next and hold the voxels of both layers, and of what `motion` tells to
    be passed between them; all others are valid throughout. Each is the tight box about the voxels in one
    cell of an octree, small where that spares most space; ids name kind, interval and cell, so they stay while things
    move within cells. `previous` keeps the cover from flickering between two that are equally good; `motion` gives
    velocities and bounds, zero without it. Unknown space is UNKNOWN where something may come out of it, UNSEEN where it
    may be full, and no obstacle where it is known to be empty: as `hidden` tells, all of it UNKNOWN without. `sighted`
    adds, to a forecast of anything, MOVING obstacles that hold what it is a forecast of, valid at the evidence alone
    (`Obstacles.as_seen`), and tells how far from there it may get.
    """
    parameters = parameters or CoverParameters()
    grid, stamps = occupancy.grid, _stamps(occupancy)
    if hidden is None:
        unknown = Bits.of_mask(grid.dims, decode_runs(occupancy.unknown_runs, grid.size))
        hidden = Hidden(reachable=unknown, maybe_full=Bits.none(grid.dims))
    maybe_full, reachable = (Share(of, parameters.unknown_share) for of in (hidden.maybe_full, hidden.reachable))
    throughout = (stamps[0], stamps[-1])
    batches = [
        *_foreseen(occupancy, parameters.most_moving, () if motion is None else motion.between),
        *(() if sighted is None else _seen(occupancy, parameters, sighted)),
        _Batch(ObstacleKind.STATIC, 0, *throughout, grid, parameters.most_static, (occupancy.static.indices,)),
        _Batch(ObstacleKind.UNSEEN, 0, *throughout, grid, parameters.most_unknown, maybe_full),
        _Batch(ObstacleKind.UNKNOWN, 0, *throughout, grid, parameters.most_unknown, reachable),
    ]
    before = np.zeros(0, np.uint32) if previous is None else previous.ids
    found = covers([batch.wanted for batch in batches], before)
    return _obstacles(occupancy.stamp, batches, found, motion, 0.0 if sighted is None else sighted.since_s)


def _stamps(occupancy: Occupancy) -> list[int]:
    """When each layer is valid, ns; raises `ForecastError` for layers between which nothing would be valid."""
    horizons = [layer.horizon_ns for layer in occupancy.layers]
    if not 2 <= len(horizons) <= min(_AS_SEEN) + 1 or any(then <= now for now, then in pairwise(horizons)):
        raise ForecastError(
            f"cover: expected 2 to {min(_AS_SEEN) + 1} layers in the order of their horizons, found {horizons} ns; "
            "what moves is held from one layer to the next"
        )
    return [occupancy.publish_stamp + horizon for horizon in horizons]


def _foreseen(occupancy: Occupancy, most: int, between: tuple[NDArray[np.int64], ...]) -> list[_Batch]:
    """From each layer to the next: the voxels of both, and those that are passed `between` them, if any is."""
    layers = [layer.indices for layer in occupancy.layers]
    passed = between or (None,) * (len(layers) - 1)
    intervals = zip(pairwise(_stamps(occupancy)), pairwise(layers), passed, strict=True)
    return [
        _Batch(ObstacleKind.MOVING, number, *valid, occupancy.grid, most, (first, _joined(second, more)))
        for number, (valid, (first, second), more) in enumerate(intervals)
    ]


def _seen(occupancy: Occupancy, parameters: CoverParameters, sighted: Sighted) -> list[_Batch]:
    """What moved where it was seen, and its rims; nothing where nothing is forecast of it."""
    if not any(len(layer.indices) for layer in occupancy.layers):
        return []
    at, most = (occupancy.stamp, occupancy.stamp), (parameters.most_seen, parameters.most_moving)
    return [
        _Batch(ObstacleKind.MOVING, interval, *at, sighted.grid, few, spreading.voxels, spreading)
        for interval, few, spreading in zip(_AS_SEEN, most, (sighted.likely, sighted.rims), strict=True)
    ]


def _joined(layer: UInt32, more: NDArray[np.int64] | None) -> NDArray[np.integer]:
    return layer if more is None or len(more) == 0 else np.concatenate([layer, more.astype(np.uint32)])


_AS_SEEN = (7, 6)
"""Stand for intervals in the ids of what was seen, and of its rims: the last that they have room for."""


@dataclass(frozen=True)
class _Batch:
    """Obstacles of one kind and interval."""

    kind: ObstacleKind
    interval: int
    valid_from: int
    valid_to: int
    grid: Grid
    most: int
    voxels: tuple[NDArray[np.integer], ...] | Share
    spreading: Spreading | None = None
    """How far it may get from there; None: its boxes say where it is."""

    @property
    def wanted(self) -> Wanted:
        """Boxes about them."""
        return Wanted(self.grid, self.most, (int(self.kind) << 3) | self.interval, self.voxels)


def _obstacles(
    stamp: int, batches: list[_Batch], found: Covers, motion: PartMotion | None, since_s: float
) -> Obstacles:
    counts, total = found.counts, len(found.ids)
    origins = np.repeat([batch.grid.origin for batch in batches], counts, axis=0)
    voxel_sizes = np.repeat([batch.grid.voxel_size for batch in batches], counts)[:, None]
    lower, upper = origins + found.lower * voxel_sizes, origins + (found.upper + 1) * voxel_sizes
    kinds = np.repeat(np.array([batch.kind for batch in batches], np.uint8), counts)
    quats = np.zeros((total, 4))
    quats[:, 0] = 1
    velocities, bounds = np.zeros((total, 3)), np.zeros(total)
    experts = np.full(total, MotionExpert.NO_EXPERT, np.uint8)
    ends = np.cumsum(counts)
    for batch, first, end in zip(batches, ends - counts, ends, strict=True):
        if motion is None or len(motion.centers) == 0 or batch.kind is not ObstacleKind.MOVING:
            continue
        rows, is_forecast = slice(first, end), batch.spreading is None
        held = motion.held(batch.interval if is_forecast else None, lower[rows], upper[rows])
        velocities[rows] = motion.sure_velocities[held.fastest]
        if is_forecast:
            bounds[rows] = motion.radii[batch.interval + 1, held.nearest]  # as wide as at the interval's end
            if motion.experts is not None:
                experts[rows] = motion.experts[held.nearest]
    reach_speeds, reach_delays = _reaches(batches, found, since_s)
    return Obstacles(
        stamp=stamp,
        ids=found.ids,
        kinds=kinds,
        shapes=np.full(total, ObstacleShape.BOX, np.uint8),
        positions=(lower + upper) / 2,
        quats=quats,
        sizes=upper - lower,
        velocities=velocities,
        bounds=bounds,
        valid_from=np.repeat(np.array([batch.valid_from for batch in batches], np.int64), counts),
        valid_to=np.repeat(np.array([batch.valid_to for batch in batches], np.int64), counts),
        experts=experts,
        reach_speeds=reach_speeds,
        reach_delays=reach_delays,
    )


def _reaches(batches: list[_Batch], found: Covers, since_s: float) -> tuple[Float64, Float64]:
    """Speeds (m/s) and delays (s) [n] of what was seen, whose forecasts begin `since_s` later.

    0 of all else, and where a forecast says nothing finite: the law then takes its own speed.
    """
    speeds, delays = np.zeros(len(found.ids)), np.zeros(len(found.ids))
    ends = np.cumsum(found.counts)
    for batch, first, end in zip(batches, ends - found.counts, ends, strict=True):
        if batch.spreading is not None:
            reached, fastest = batch.spreading.within(found.lower[first:end], found.upper[first:end])
            rows = first + np.flatnonzero(np.isfinite(reached) & np.isfinite(fastest))
            speeds[rows] = np.maximum(fastest[rows - first], _LEAST_SPEED)
            delays[rows] = since_s - reached[rows - first] / speeds[rows]
    return speeds, delays


_LEAST_SPEED = 1e-3
"""Least speed that is told, m/s: none would mean that nothing is known."""
