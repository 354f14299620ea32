"""What was seen to move, where it was seen, and how far from there the forecast lets it get."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.ahead import RIM_RADIUS
from twin_node.forecast.growth import ROUNDING
from twin_node.forecast.parts import Parts, split
from twin_node.forecast.prediction import Prediction
from twin_node.scene import Float64, Grid


@dataclass(frozen=True)
class Spreading:
    """Voxels in K groups, and how far each group may get from where it was seen.

    Forecasts begin some time after the evidence; by then a group has got `reached` far at most, and at most at `speeds`
    from then on, until the last horizon.
    """

    voxels: tuple[NDArray[np.int64], ...]
    """Flat indices in one or two lists, in any order; some may be in both."""
    lower: NDArray[np.int64]
    """[K, 3] first voxel of each group's cell."""
    upper: NDArray[np.int64]
    """[K, 3] last voxel."""
    reached: Float64
    """[K] m."""
    speeds: Float64
    """[K] m/s."""

    def within(self, lower: NDArray[np.int64], upper: NDArray[np.int64]) -> tuple[Float64, Float64]:
        """`reached` and `speeds` [b] that hold for all groups with cells in boxes of voxels, given by corners [b, 3].

        Infinite for boxes without any: nothing is known of them.
        """
        meet = np.ones((len(lower), len(self.reached)), np.bool_)
        for axis in range(3):
            meet &= lower[:, axis, None] <= self.upper[:, axis]
            meet &= upper[:, axis, None] >= self.lower[:, axis]
        reached, speeds = (
            np.where(meet, values, -np.inf).max(axis=1, initial=-np.inf) for values in (self.reached, self.speeds)
        )
        is_known = meet.any(axis=1)
        return np.where(is_known, reached, np.inf), np.where(is_known, speeds, np.inf)


@dataclass(frozen=True)
class Sighted:
    """What was seen to move on one grid, a rim about the workspace included."""

    grid: Grid
    likely: Spreading
    """What moves, or rests and may start."""
    rims: Spreading
    """What only errors of the carving add: it goes with the parts and is widened little."""
    since_s: float
    """From the evidence to the first horizon, s."""


def sighted(
    grid: Grid, parts: Parts, resting: NDArray[np.int64], prediction: Prediction, started: Float64, horizons: Float64
) -> Sighted:
    """Parts where they were seen, and what rests: flat indices [n], which may get `started` [H] (m) far.

    `grid` is that of the indices; `horizons` [H] are counted from the evidence, s. What is held along all of its way,
    or where it swerves to, is as far from where it was seen as the forecast holds it.
    """
    gone = np.linalg.norm(prediction.displacements, axis=-1)
    swerves = prediction.swerves
    far = np.where(swerves.held, np.linalg.norm(swerves.displacements, axis=-1), 0.0)
    rounding = ROUNDING * grid.voxel_size  # as the layers have it, with which radii are calibrated
    near = gone + np.minimum(prediction.radii, RIM_RADIUS) + rounding
    lying = split(grid, resting, np.ones(len(resting), np.bool_))
    reach = np.maximum(gone, far) + prediction.radii + rounding
    rests = np.repeat(started[:, None] + rounding, lying.count, axis=1)
    likely, rims = parts.likely, ~parts.likely
    moving = parts.cells(grid)
    lower, upper = (np.concatenate(pair) for pair in zip(moving, lying.cells(grid), strict=True))
    both = (parts.indices[likely], lying.indices)
    return Sighted(
        grid=grid,
        likely=Spreading(both, lower, upper, *_lines(np.concatenate([reach, rests], axis=1), horizons)),
        rims=Spreading((parts.indices[rims],), *moving, *_lines(near, horizons)),
        since_s=float(horizons[0]),
    )


def _lines(reach: Float64, horizons: Float64) -> tuple[Float64, Float64]:
    """`reached` and `speeds` [K] of lines from the first horizon on, above what is reached [H, K] at every horizon."""
    later = (horizons[1:] - horizons[0])[:, None]
    return reach[0], ((reach[1:] - reach[0]) / later).max(axis=0, initial=0.0)
