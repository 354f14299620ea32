"""How soon vacated space is reported free, and whether unseen space ever is: scored against exact truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.grid import decode_runs
from twin_node.forecast.growth import grown
from twin_node.forecast.own_space import own_space
from twin_node.model.rays import look
from twin_node.robot import ArmModel
from twin_node.scene import Bool, Float64, Grid, Occupancy, TwinState, View

UNSEEN_EVERY = 10
"""Every so many sets the whole grid is looked through for unseen space."""
CLEAR_VOXELS = 3.0
"""Space is vacated when all that moves is this far away, voxels: nearer space is kept for errors of the sensors."""
BEHIND_VOXELS = 3.0
"""A voxel this far behind a measured surface is certainly hidden by it, voxels."""


@dataclass(frozen=True)
class SpaceScore:
    """What became of vacated and of unseen space; None where there was none."""

    vacated_free_ms_p95: float | None
    """95 % of the voxels that a thing left by `CLEAR_VOXELS`, that a camera sees to be empty, and that were reported
    free before the run ended, were so within this time."""
    vacated_voxels: int
    """Those that were."""
    vacated_waiting: int
    """The others that had waited for longer than that when the run ended; what the twin took for furniture is among
    them."""
    unseen_not_free: float | None
    """Share of the voxels hidden from every camera that were reported unknown or occupied."""


class SpaceTally:
    """Follows voxels from the time that they are left until they are reported free."""

    def __init__(self, grid: Grid, arm: ArmModel | None = None) -> None:
        """`arm`: where the states' joints are those of this arm, its own space is no unseen space."""
        self._grid, self._arm = grid, arm
        self._was_occupied = np.zeros(grid.size, np.bool_)
        self._furniture = np.zeros(grid.size, np.bool_)
        """Said to stand before anything that moves had been there."""
        self._since = np.zeros(grid.size, np.int64)
        self._latencies: list[NDArray[np.int64]] = []
        self._published = 0
        self._unseen = self._unseen_blocked = 0
        self._sets = 0

    def add(self, state: TwinState, forecast: Occupancy, occupied_points: Float64 | None) -> None:
        """Takes in a state with depth, what was said of it, and points [n, 3] (m) truly occupied at its stamp."""
        if occupied_points is None or any(view.depth is None for view in state.frames.views):
            return
        places = self._grid.indices(occupied_points)
        occupied = np.zeros(self._grid.size, np.bool_)
        occupied[places[places >= 0]] = True
        blocked = decode_runs(forecast.unknown_runs, self._grid.size)
        blocked[forecast.layers[0].indices] = True
        blocked[forecast.static.indices] = True
        self._follow_vacated(state, forecast, occupied, blocked)
        if self._sets % UNSEEN_EVERY == 0:
            hidden = np.flatnonzero(~occupied & _hidden(state, self._grid) & ~self._arms_own(state))
            self._unseen += len(hidden)
            self._unseen_blocked += int(np.count_nonzero(blocked[hidden]))
        self._sets += 1

    def score(self) -> SpaceScore:
        """The score so far."""
        latencies = np.concatenate(self._latencies) if self._latencies else np.zeros(0, np.int64)
        p95 = float(np.quantile(latencies, 0.95)) if len(latencies) else None
        waited = self._published - self._since[self._since > 0]
        return SpaceScore(
            None if p95 is None else p95 * 1e-6,
            len(latencies),
            int(np.count_nonzero(waited > (p95 or 0))),
            self._unseen_blocked / self._unseen if self._unseen else None,
        )

    def _arms_own(self, state: TwinState) -> Bool:
        """[grid.size] voxels that the arm takes up: no camera sees them, and they are no obstacle to it."""
        if self._arm is None or state.frames.joints is None:
            return np.zeros(self._grid.size, np.bool_)
        return own_space(self._grid, self._arm, state.frames.joints.at(state.frames.stamp)).mask()

    def _follow_vacated(self, state: TwinState, forecast: Occupancy, occupied: Bool, blocked: Bool) -> None:
        self._was_occupied |= occupied
        stands = forecast.static.indices
        self._furniture[stands[~self._was_occupied[stands]]] = True
        self._was_occupied &= ~self._furniture
        self._since[occupied] = 0
        near = grown(self._grid, occupied, CLEAR_VOXELS)
        left = np.flatnonzero(self._was_occupied & ~near & (self._since == 0))
        self._since[left[_seen_empty(state, self._grid, left)]] = state.stamp
        self._published = forecast.publish_stamp
        free = np.flatnonzero((self._since > 0) & ~blocked)
        self._latencies.append(forecast.publish_stamp - self._since[free])
        self._since[free] = 0
        self._was_occupied[free] = False


def _seen_empty(state: TwinState, grid: Grid, indices: NDArray[np.int64]) -> Bool:
    """Whether some camera measures a surface at least a voxel behind each voxel [n], off the arm."""
    seen = np.zeros(len(indices), np.bool_)
    for view, robot in zip(state.frames.views, state.robot_masks, strict=True):
        rays = _Rays(view, robot, grid.centers(indices))
        seen |= rays.inside & ~rays.on_robot & (rays.surface > rays.depth + grid.voxel_size)
    return seen


def _hidden(state: TwinState, grid: Grid) -> Bool:
    """[grid.size] voxels that no camera sees for certain: outside its image, or behind the surface that it measures.

    The arm's surface hides what is behind it as any other does; what is before it is seen.
    """
    hidden = np.ones(grid.size, np.bool_)
    centers = grid.centers(np.arange(grid.size))
    for view, robot in zip(state.frames.views, state.robot_masks, strict=True):
        rays = _Rays(view, robot, centers)
        behind = (rays.surface > 0) & (rays.surface < rays.depth - BEHIND_VOXELS * grid.voxel_size)
        hidden &= ~rays.inside | behind
    return hidden


class _Rays:
    """What one view shows where points project."""

    def __init__(self, view: View, robot: Bool | None, points: Float64) -> None:
        assert view.depth is not None
        at = look(view.camera, points)
        self.depth, self.inside = at.depth, at.inside
        self.surface = np.where(at.inside, view.depth[at.rows, at.columns], 0)
        self.on_robot = np.zeros(len(points), np.bool_) if robot is None else at.inside & at.within(robot)
