"""What fast parts pass through between two horizons: the layers alone would be apart, and their obstacles too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.ahead import RIM_RADIUS
from twin_node.forecast.growth import reach_of, shifts_of, spread
from twin_node.forecast.parts import PART_SIZE, Parts
from twin_node.scene import Float64, Grid

MOST_PIECES = 16
"""A way is cut into no more: that is enough for 25 m/s, and no path goes at more than `tracks.MOST_SPEED`."""


def passed_between(grid: Grid, parts: Parts, displacements: Float64, radii: Float64) -> tuple[NDArray[np.int64], ...]:
    """Voxels that M parts reach on their way from one of H horizons to the next: flat indices [n] per interval.

    `displacements` [H, M, 3] and bounds `radii` [H, M] are those of the layers, m. A part that goes no farther in an
    interval than its size and its bound is held by the layers; of others places are added, no farther apart than that.
    Rims are widened little, as in the layers.
    """
    steps = np.linalg.norm(np.diff(displacements, axis=0), axis=-1)
    pieces = np.ceil(steps / (PART_SIZE + np.minimum(radii[:-1], radii[1:]))).clip(0, MOST_PIECES)
    return tuple(
        _passed(grid, parts, displacements[k : k + 2], radii[k : k + 2], pieces[k]) for k in range(len(pieces))
    )


def _passed(grid: Grid, parts: Parts, ends: Float64, radii: Float64, pieces: NDArray[np.floating]) -> NDArray[np.int64]:
    """Of one interval, from `ends` [2, M, 3] and `radii` [2, M], in as many `pieces` [M] as each part's way has."""
    fast = pieces > 1
    if not fast.any():
        return np.zeros(0, np.int64)
    shares = np.arange(1, pieces.max()) / pieces.max()
    chosen, (begin, end) = parts.of(fast), ends[:, fast]
    moved = begin + shares[:, None, None] * (end - begin)
    wide = np.tile(radii[:, fast].max(axis=0), (len(shares), 1))
    both = np.concatenate([wide, np.minimum(wide, RIM_RADIUS)], axis=1)
    shifts = shifts_of(grid, np.concatenate([moved, moved], axis=1))
    layers = spread(grid, chosen.points_and_rims, shifts, reach_of(grid, both))
    return np.unique(np.concatenate([layer.indices for layer in layers])).astype(np.int64)
