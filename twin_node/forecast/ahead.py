"""Where parts may be in every layer: moved, widened, and held along their ways where they may turn back or swerve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Masks, all_told
from twin_node.forecast.growth import FARTHEST, REACHES, ROUNDING, reach_of, shifts_of, spread_reference
from twin_node.forecast.kernel_requests import AheadRequest, GrowRequest
from twin_node.forecast.kernels import Kernels, kernels
from twin_node.forecast.parts import PART_SIZE, Parts
from twin_node.forecast.swerving import Swerves, beside
from twin_node.forecast.turning import MOST_STEPS, NARROWER, whole_ways
from twin_node.native_library import addresses_of, thread_count
from twin_node.scene import HORIZONS_NS, Bool, Float64, Grid, OccupancyLayer

CORE_PROBABILITY = 230
"""Of voxels where the likely voxels of the parts are forecast."""
BOUND_PROBABILITY = 90
"""Of voxels that only the errors of the carving and the error bound add."""
RIM_RADIUS = 0.05
"""Largest radius of rims, m: two voxels, and half of one for rounding."""


@dataclass(frozen=True)
class Ahead:
    """What is forecast of M parts at `HORIZONS_NS`, and what else may start."""

    parts: Parts
    """Their voxels, in the coordinates of the grid that is forecast."""
    displacements: Float64
    """[H, M, 3] m."""
    radii: Float64
    """[H, M] bound about the displaced parts, m."""
    turning: Bool
    """[M] those that are held along all of their way."""
    swerves: Swerves
    """Where they get if they go on to accelerate."""
    resting: NDArray[np.int32]
    """[3, n] voxel coordinates of what rests, and may start."""
    started: Float64
    """[H] how far that may get, m."""


def layers_of(grid: Grid, ahead: Ahead) -> tuple[OccupancyLayer, ...]:
    """Every part moved on, widened by the bound and held where it may turn back or swerve, per horizon.

    Rims, which only errors of the carving add, go with their parts and are widened little: what moves is elsewhere.
    Bounds within the rounding to voxels, as those of now are, do not widen them: they are errors already.
    What leaves is outside already, where a wider bound blocks nothing, and what matters is that it may return: it is
    held along all of its way. Compiled; `layers_of_reference` where that cannot be.
    """
    compiled = kernels()
    return layers_of_reference(grid, ahead) if compiled is None else _layers_by(compiled, grid, ahead)


def _layers_by(compiled: Kernels, grid: Grid, ahead: Ahead) -> tuple[OccupancyLayer, ...]:
    parts, layers, threads = ahead.parts, len(ahead.radii), thread_count()
    swerves = (ahead.swerves.displacements, ahead.swerves.held)
    lengths = (ahead.displacements, ahead.radii, ahead.turning, *swerves, ahead.started, REACHES)
    given = (grid.origin, parts.places, parts.labels, parts.likely, ahead.resting, parts.centers, *lengths)
    arrays = tuple(np.ascontiguousarray(array) for array in given)
    room = Masks.room(grid.dims, layers)
    grown = GrowRequest(0, layers, 0, *grid.dims, threads, *(None,) * 5, *addresses_of(*room.arrays))
    counts = (len(parts.labels), ahead.resting.shape[1], parts.count, layers, len(REACHES), MOST_STEPS, FARTHEST)
    shares = (RIM_RADIUS, NARROWER, PART_SIZE, ROUNDING, grid.voxel_size)
    compiled.run(AheadRequest(*counts, *shares, *addresses_of(*arrays), grown))
    found = all_told(compiled, room, CORE_PROBABILITY, BOUND_PROBABILITY, threads)
    return tuple(OccupancyLayer(horizon, *one) for horizon, one in zip(HORIZONS_NS, found, strict=True))


def layers_of_reference(grid: Grid, ahead: Ahead) -> tuple[OccupancyLayer, ...]:
    """What `layers_of` does."""
    parts, still = ahead.parts, np.zeros((len(ahead.started), 1, 3))
    moved = np.concatenate([ahead.displacements, ahead.displacements, still], axis=1)
    rims = np.where(ahead.radii > ROUNDING * grid.voxel_size, np.minimum(ahead.radii, RIM_RADIUS), 0.0)
    radii = np.concatenate([ahead.radii, rims, ahead.started[:, None]], axis=1)
    may_turn = np.append(np.tile(ahead.turning | _leaves(grid, ahead), 2), False)
    points = parts.points_and_rims.beside(ahead.resting, 2 * parts.count)
    ways = beside(whole_ways(points, moved, radii, may_turn), parts.points, ahead.swerves)
    spreads = spread_reference(grid, ways.points, shifts_of(grid, ways.displacements), reach_of(grid, ways.radii))
    core, bound = np.uint8(CORE_PROBABILITY), np.uint8(BOUND_PROBABILITY)
    return tuple(
        OccupancyLayer(horizon, reached.indices, np.where(reached.core, core, bound))
        for horizon, reached in zip(HORIZONS_NS, spreads, strict=True)
    )


def _leaves(grid: Grid, ahead: Ahead) -> Bool:
    """[M] parts that are outside the grid, and stay there."""
    here = ahead.parts.centers
    leaves: Bool = (grid.indices(here) < 0) & (grid.indices(here + ahead.displacements[-1]) < 0)
    return leaves
