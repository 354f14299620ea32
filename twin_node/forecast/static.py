"""Space that stands still: where STATIC Gaussians or measured surfaces are."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Bits
from twin_node.forecast.carving import Carver, Opaque
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.kernel_requests import MarkRequest
from twin_node.forecast.kernels import kernels
from twin_node.forecast.unprojection import FINER, from_middle, unproject
from twin_node.forecast.verdicts import Carved
from twin_node.native_library import addresses_of
from twin_node.ranges import NOT_NEGATIVE, SHARE, check_ranges
from twin_node.scene import Bool, Grid, OccupancyLayer, Tier, TwinState, View
from twin_node.turns import Turns

GUESSED_M = 0.13
"""How far behind a Gaussian what it stands for may lie where no camera measures, m: places are guesses there."""
STRAYS_M = 0.06
"""How far off an arm its surface may have been measured, m: three times the noise of depth at 2 m. What is left there
may hold the arm for good: while it stands no camera sees through."""


@dataclass(frozen=True)
class StaticParameters:
    """What counts as standing, and how often it is looked at again."""

    opacity: float = 0.5
    """A STATIC Gaussian at least this opaque occupies the voxel that its centre is in."""
    period_ns: int = 500_000_000
    """Each camera is looked at anew this often, one after the other: what stands does not change faster."""

    def __post_init__(self) -> None:
        """Raises `ForecastError` for a number that is none of its kind."""
        check_ranges(self, ForecastError, "forecast: static.", opacity=SHARE, period_ns=NOT_NEGATIVE)


class StaticSpace:
    """The voxels that stand still, refreshed now and then; what has moved off is free at once."""

    def __init__(self, grid: Grid, parameters: StaticParameters | None = None) -> None:
        self.grid = grid
        self.parameters = parameters or StaticParameters()
        self._surfaces = np.zeros(grid.size, np.bool_)
        self._doubtful: Bool | None = None
        """Surfaces that were first measured while nobody told where the arm is, and may be the arm's."""
        self.opaque = Opaque(np.zeros(0, np.int64))
        """What cameras without depth do not see past, the same until it is refreshed: what some camera has measured, or
        where none measures, what the Gaussians fill."""
        self._layer = _standing(np.zeros(0, np.uint32))
        self._measured = Bits.none(grid.dims)
        """What stands by its measured surface alone."""
        self._moved: dict[str, Bool] = {}
        """By camera, the pixels [H, W] that have shown something move since the layer was refreshed."""
        self._measuring: set[str] = set()
        """Names of the cameras that have sent depth."""
        self._made_at: int | None = None
        self._turns = Turns()

    def update(
        self, state: TwinState, carver: Carver, own: Bits | None = None, carved: Carved | None = None
    ) -> OccupancyLayer:
        """The static layer as of this state, of which `carver` says what is `carved`, if that is known yet.

        `own`: the arm's own space; None where there is no arm, or nobody tells where it is: once somebody does, what
        was taken to stand in its place is no longer, nor what was close about it unless it is measured again.
        """
        names = [view.camera.name for view in state.frames.views]
        if own is not None and self._doubtful is not None:
            self._surfaces[self._around(own).mask() & self._doubtful] = False
            self._doubtful, self._made_at = None, None
        self._measuring.update(view.camera.name for view in state.frames.views if view.depth is not None)
        is_due = self._is_due(state)
        if is_due:
            chosen = range(len(names)) if self._made_at is None or not names else (self._turns.whose(names),)
            self._made_at = state.stamp
            self._turns.take([names[number] for number in chosen])
            self._remember_surfaces(state, carver, chosen, own is not None)
            filled = self._gaussian_voxels(state)
            measures = any(view.depth is not None for view in state.frames.views) or self._surfaces.any()
            self.opaque = Opaque(np.flatnonzero(self._surfaces)) if measures else Opaque(np.unique(filled), GUESSED_M)
            occupied, measured = self._surfaces.copy(), self._surfaces.copy()
            occupied[filled], measured[filled] = True, False
            self._layer = _standing(np.flatnonzero(occupied))
            self._measured = Bits.of_mask(self.grid.dims, measured)
            self._moved.clear()
        for view, moving in zip(state.frames.views, state.moving_masks, strict=True):
            before = self._moved.get(view.camera.name, moving)
            self._moved[view.camera.name] = moving | before if before.shape == moving.shape else moving
        if carved is not None and not is_due:
            self._leave(state, carver, carved)
        return self._layer

    def _is_due(self, state: TwinState) -> bool:
        """Whether the next camera is to be looked at.

        One that measures depth is waited for as long again while its depth image is missing: where these come with
        every other set, turns would else come with the sets in between for good.
        """
        if self._made_at is None:
            return True
        views, wait = state.frames.views, self.parameters.period_ns
        if views:
            first = views[self._turns.whose([view.camera.name for view in views])]
            wait *= 2 if first.depth is None and first.camera.name in self._measuring else 1
        return (state.stamp - self._made_at) * len(views) >= wait

    def _leave(self, state: TwinState, carver: Carver, carved: Carved) -> None:
        """Takes out the surfaces of what has moved and is seen to be gone.

        Who had stood there since the first images was told to stand, and so was the place that they left, until every
        camera's turn had come. Only through pixels that have shown something move: noise frees a voxel of what stands
        now and then.
        """
        if not any(pixels.any() for pixels in self._moved.values()):
            return
        free = self._measured.without(carved.may_move | carved.unknown | carved.on_arm).indices()
        gone = free[carver.frees(state, free, self._moved)]
        if len(gone):  # else the layer stays the one that it was, and what follows from it too
            left = Bits.of_indices(self.grid.dims, gone)
            self._surfaces[gone] = False
            self._measured = self._measured.without(left)
            self._layer = _standing(self._layer.indices[~left.holds(self._layer.indices)])

    def _around(self, own: Bits) -> Bits:
        for _ in range(math.ceil(STRAYS_M / self.grid.voxel_size)):
            own = own.grown()
        return own

    def _remember_surfaces(self, state: TwinState, carver: Carver, chosen: Iterable[int], knows_arm: bool) -> None:
        """Forgets surfaces that a camera sees through; adds those that the chosen views measure off their masks."""
        if not any(view.depth is not None for view in state.frames.views):
            return
        before = None if knows_arm else self._surfaces.copy()
        known = np.flatnonzero(self._surfaces)
        self._surfaces[known[carver.frees(state, known)]] = False
        for number in chosen:
            view, moving, robot = state.frames.views[number], state.moving_masks[number], state.robot_masks[number]
            if view.depth is None:
                continue
            still = (view.depth > 0) & ~moving
            if robot is not None:
                still &= ~robot
            if view.valid is not None:  # nobody tells what moves there
                still &= view.valid
            mark(self.grid, self._surfaces, replace(view, depth=carver.calmed(view)), still)
        if before is not None:
            new = self._surfaces & ~before
            self._doubtful = new if self._doubtful is None else self._doubtful | new

    def _gaussian_voxels(self, state: TwinState) -> NDArray[np.int64]:
        """Voxels that the centres of the opaque STATIC Gaussians are in; none of what is much larger than a voxel."""
        cloud = state.gaussians
        chosen = (cloud.tiers == Tier.STATIC) & (cloud.opacities >= self.parameters.opacity)
        largest = functools.reduce(np.maximum, cloud.scales.T)  # column by column: rows of three take NumPy long
        chosen &= largest < 20 * self.grid.voxel_size
        found = self.grid.indices(cloud.means[chosen])
        return found[found >= 0]


def _standing(indices: NDArray[np.integer]) -> OccupancyLayer:
    """Voxels at flat indices [n] that stand for certain."""
    return OccupancyLayer(0, indices.astype(np.uint32), np.full(len(indices), 255, np.uint8))


def mark(grid: Grid, marked: Bool, view: View, where: Bool) -> None:
    """Sets the voxels in a flat mask [grid.size] that hold what a view with depth measures in `where` [H, W].

    Compiled; `mark_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        mark_reference(grid, marked, view, where)
        return
    assert view.depth is not None
    height, width = view.depth.shape
    K, T = view.camera.K, view.camera.T_base_cam
    arrays: tuple[NDArray[np.generic], ...] = (
        np.ascontiguousarray(grid.origin, np.float64),
        np.ascontiguousarray(view.depth, np.float32),
        np.ascontiguousarray(where, np.bool_),
        *(from_middle(np.arange(size * FINER), center) for size, center in ((width, K[0, 2]), (height, K[1, 2]))),
        K[[0, 1], [0, 1]].astype(np.float32),
        np.ascontiguousarray(T[:3], np.float32),
        marked,
    )
    sizes = (width, height, FINER, *grid.dims, grid.voxel_size)
    compiled.run(MarkRequest(*sizes, *addresses_of(*arrays)))


def mark_reference(grid: Grid, marked: Bool, view: View, where: Bool) -> None:
    """What `mark` does."""
    found = grid.indices(unproject(view, where))
    marked[found[found >= 0]] = True
