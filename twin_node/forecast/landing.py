"""What flying things will land on."""

from __future__ import annotations

import numpy as np

from twin_node.forecast.bits import Bits
from twin_node.forecast.experts import GRAVITY
from twin_node.forecast.things import Whole
from twin_node.scene import Bool, Float64, Grid


def floors_of(grid: Grid, stands: Bits, centers: Float64, whole: Whole) -> Float64:
    """[M] heights (m) that the middles of parts at `centers` [M, 3] (m) do not get below while they fall.

    For what falls: what stands (`stands`, of the grid) where the lowest of its thing first comes down on it; -inf where
    nothing does, and for all else.
    """
    floors = np.full(len(centers), -np.inf)
    rows = np.flatnonzero(whole.falling)
    if len(rows) == 0:
        return floors
    velocities, lowest = whole.velocities[rows], centers[rows] - whole.above[rows, None] * _UP
    fastest = float(np.linalg.norm(velocities, axis=1).max()) - GRAVITY[2] * _AHEAD_S
    times = np.linspace(0, _AHEAD_S, 2 + int(fastest * _AHEAD_S / grid.voxel_size))[:, None, None]
    way = lowest + times * velocities + times**2 / 2 * GRAVITY
    lands = _held(grid, stands, way) & ~_held(grid, stands, way + grid.voxel_size * _UP)
    first = lands.argmax(axis=0)
    height = way[first, np.arange(len(rows)), 2] - grid.origin[2]
    top = grid.origin[2] + grid.voxel_size * np.ceil(height / grid.voxel_size)
    floors[rows] = np.where(lands.any(axis=0), top + whole.above[rows], -np.inf)
    return floors


def _held(grid: Grid, mask: Bits, points: Float64) -> Bool:
    """[T, n] whether a mask has the voxels at points [T, n, 3] (m)."""
    indices = grid.indices(points.reshape(-1, 3)).reshape(points.shape[:2])
    held: Bool = (indices >= 0) & mask.holds(np.maximum(indices, 0))
    return held


_AHEAD_S = 0.4
"""How far ahead it is looked what a thing comes down on, s: the last horizon and a large latency."""
_UP = np.array([0.0, 0.0, 1.0])
