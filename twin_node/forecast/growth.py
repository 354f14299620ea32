"""Growth of moving space: every part moved on and widened by balls, exactly, for all layers at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Masks, all_told
from twin_node.forecast.kernel_requests import GrowRequest
from twin_node.forecast.kernels import Kernels, kernels
from twin_node.native_library import addresses_of, thread_count
from twin_node.scene import Bool, Float64, Grid, UInt32


@dataclass(frozen=True)
class Spread:
    """Voxels reached by balls about points."""

    indices: UInt32
    """[n] flat indices, strictly increasing."""
    core: Bool
    """[n] True for voxels that hold a core point themselves."""


@dataclass(frozen=True)
class Points:
    """Voxels of parts, inside a grid or beside it."""

    places: NDArray[np.int32]
    """[3, n] voxel coordinates (i, j, k)."""
    labels: NDArray[np.int64]
    """[n] part of each."""
    core: Bool
    """[n] whether it makes its voxel a core."""

    def beside(self, places: NDArray[np.int32], label: int) -> Points:
        """These, and others at `places` [3, m] of one more part: no cores."""
        count = places.shape[1]
        if count == 0:
            return self
        labels, core = np.full(count, label, np.int64), np.zeros(count, np.bool_)
        return Points(
            np.concatenate([self.places, places], axis=1),
            np.concatenate([self.labels, labels]),
            np.concatenate([self.core, core]),
        )


UInt16 = NDArray[np.uint16]

PER_VOXEL = 4
"""Units of reach in a voxel's edge."""


def reach_of(grid: Grid, radii: Float64) -> UInt16:
    """Radii [...] (m) as reach in quarter voxels, rounded up: by at most a seventh, as every level costs time.

    Half a voxel's diagonal is added for the rounding of places to voxels, to all but radii of 0.
    """
    reach = PER_VOXEL * (radii / grid.voxel_size + np.where(radii > 0, ROUNDING, 0)) - 1e-6
    return np.asarray(REACHES[np.minimum(np.searchsorted(REACHES, reach), len(REACHES) - 1)])


ROUNDING = float(np.sqrt(3) / 2)
"""How far a place is from the middle of its voxel at most, voxels."""
REACHES = np.array(
    [
        *(*range(12), *range(12, 24, 2), *range(24, 48, 4), *range(48, 96, 8), *range(96, 241, 16)),
        *(*range(272, 513, 32), *range(576, 1025, 64), *range(1152, 4097, 128)),
    ],
    np.uint16,
)
"""Quarter voxels that radii are rounded up to: up to a thousand voxels, more than the sides of grids of such voxels."""


def shifts_of(grid: Grid, displacements: Float64) -> NDArray[np.int32]:
    """Displacements [..., 3] (m) in whole voxels, to the nearest."""
    return np.round(displacements / grid.voxel_size).clip(-FARTHEST, FARTHEST).astype(np.int32)


FARTHEST = 1 << 20
"""Voxels beyond any grid."""


def spread(grid: Grid, points: Points, shifts: NDArray[np.int32], reach: UInt16) -> tuple[Spread, ...]:
    """Per layer the voxels of `grid` within a part's reach of one of its points.

    In each of H layers every part of `points` has moved by its `shifts` [H, M, 3] (voxels) and has its `reach` [H, M]
    (quarter voxels). Compiled; `spread_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return spread_reference(grid, points, shifts, reach)
    return _spread_by(compiled, grid, points, shifts, reach)


def _spread_by(
    compiled: Kernels, grid: Grid, points: Points, shifts: NDArray[np.int32], reach: UInt16
) -> tuple[Spread, ...]:
    (layers, parts), room = reach.shape, Masks.room(grid.dims, len(reach))
    given = (
        points.places.astype(np.int32),
        points.labels.astype(np.int64),
        points.core,
        shifts,
        reach.astype(np.uint16),
    )
    arrays = (*(np.ascontiguousarray(array) for array in given), *room.arrays)
    compiled.run(GrowRequest(len(points.labels), layers, parts, *grid.dims, thread_count(), *addresses_of(*arrays)))
    found = all_told(compiled, room, marked=1, unmarked=0, threads=thread_count())
    return tuple(Spread(one.indices, one.values.view(np.bool_)) for one in found)


def spread_reference(grid: Grid, points: Points, shifts: NDArray[np.int32], reach: UInt16) -> tuple[Spread, ...]:
    """What `spread` does, by exact distance transforms: one per layer and reach."""
    return tuple(
        _layer_reference(grid, points.places + layer.T[:, points.labels], own[points.labels], points.core)
        for layer, own in zip(shifts, reach, strict=True)
    )


def _layer_reference(grid: Grid, places: NDArray[np.int32], reach: UInt16, core_points: Bool) -> Spread:
    from scipy.ndimage import distance_transform_edt  # loads slowly, and kernels do without

    reached, core = np.zeros((2, *grid.dims), np.bool_)
    dims = np.array(grid.dims)[:, None]
    for level in np.unique(reach):
        margin = int(level) // PER_VOXEL
        mine = places[:, reach == level]
        mine = mine[:, ((mine >= -margin) & (mine < dims + margin)).all(axis=0)]
        if mine.shape[1] == 0:
            continue
        first = np.minimum(mine.min(axis=1), 0)
        past = np.maximum(mine.max(axis=1) + 1, grid.dims)
        away = np.ones(past - first, np.bool_)
        away[tuple(mine - first[:, None])] = False
        inner = tuple(slice(start, start + n) for start, n in zip(-first, grid.dims, strict=True))
        reached |= distance_transform_edt(away)[inner] <= level / PER_VOXEL
    inside = ((places >= 0) & (places < dims)).all(axis=0) & core_points
    core[tuple(places[:, inside])] = True
    indices = np.flatnonzero(reached).astype(np.uint32)
    return Spread(indices, core.ravel()[indices])


def grown(grid: Grid, mask: Bool, voxels: float) -> Bool:
    """Flat mask [grid.size] of the voxels whose centres lie within a whole quarter of `voxels` of a set one's."""
    indices = np.flatnonzero(mask)
    places = np.stack(np.unravel_index(indices, grid.dims)).astype(np.int32)
    points = Points(places, np.zeros(len(indices), np.int64), np.ones(len(indices), np.bool_))
    reach = np.array([[PER_VOXEL * voxels]], np.uint16)
    (reached,) = spread(grid, points, np.zeros((1, 1, 3), np.int32), reach)
    larger = np.zeros(grid.size, np.bool_)
    larger[reached.indices] = True
    return larger
