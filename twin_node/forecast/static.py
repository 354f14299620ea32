"""Space that stands still: where STATIC Gaussians or measured surfaces are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.carving import Carver
from twin_node.scene import Float32, Grid, OccupancyLayer, Tier, TwinState, View


@dataclass(frozen=True)
class StaticParameters:
    """What counts as standing, and how often it is looked at again."""

    opacity: float = 0.5
    """A STATIC Gaussian at least this opaque occupies the voxels within one standard deviation of its centre."""
    period_ns: int = 500_000_000
    """Each camera is looked at anew this often, one after the other: what stands does not change faster."""


class StaticSpace:
    """The voxels that stand still, refreshed now and then."""

    def __init__(self, grid: Grid, parameters: StaticParameters | None = None) -> None:
        self.grid = grid
        self.parameters = parameters or StaticParameters()
        self._surfaces = np.zeros(grid.size, np.bool_)
        self._layer = OccupancyLayer(0, np.zeros(0, np.uint32), np.zeros(0, np.uint8))
        self._made_at: int | None = None
        self._turn = 0

    def update(self, state: TwinState, carver: Carver) -> OccupancyLayer:
        """The static layer as of this state."""
        count = len(state.frames.views)
        if self._made_at is None or (state.stamp - self._made_at) * count >= self.parameters.period_ns:
            chosen = range(count) if self._made_at is None else (self._turn % count,)
            self._made_at = state.stamp
            self._turn += 1
            self._remember_surfaces(state, carver, chosen)
            occupied = self._surfaces.copy()
            occupied[self._gaussian_voxels(state)] = True
            indices = np.flatnonzero(occupied).astype(np.uint32)
            self._layer = OccupancyLayer(0, indices, np.full(len(indices), 255, np.uint8))
        return self._layer

    def _remember_surfaces(self, state: TwinState, carver: Carver, chosen: Iterable[int]) -> None:
        """Forgets surfaces that a camera sees through; adds those that the chosen views measure off their masks."""
        if not any(view.depth is not None for view in state.frames.views):
            return
        known = np.flatnonzero(self._surfaces)
        self._surfaces[known[carver.frees(state, known)]] = False
        for number in chosen:
            view, moving, robot = state.frames.views[number], state.moving_masks[number], state.robot_masks[number]
            if view.depth is None:
                continue
            still = (view.depth > 0) & ~moving if robot is None else (view.depth > 0) & ~moving & ~robot
            found = self.grid.indices(unproject(view, still))
            self._surfaces[found[found >= 0]] = True

    def _gaussian_voxels(self, state: TwinState) -> NDArray[np.int64]:
        """Voxels within one standard deviation of the opaque STATIC Gaussians."""
        cloud = state.gaussians
        chosen = (cloud.tiers == Tier.STATIC) & (cloud.opacities >= self.parameters.opacity)
        chosen &= cloud.scales.max(axis=1, initial=0) < 20 * self.grid.voxel_size
        found = self.grid.indices(cloud.means[chosen])
        return found[found >= 0]


FINER = 3
"""Points along each side of a pixel: where a surface is seen at a slant, pixels are wider than voxels."""


def unproject(view: View, where: NDArray[np.bool_], finer: int = FINER) -> Float32:
    """Base-frame points [n, 3] (m) of the pixels in `where` [H, W] of a view with depth: `finer`^2 all over each."""
    assert view.depth is not None
    fine = cv2.resize(where.astype(np.uint8), None, fx=finer, fy=finer, interpolation=cv2.INTER_NEAREST)
    rows, columns = np.nonzero(fine)
    z = view.depth[rows // finer, columns // finer]
    K, T = view.camera.K, view.camera.T_base_cam
    x = ((columns + 0.5) / finer - K[0, 2]).astype(np.float32) * z / np.float32(K[0, 0])
    y = ((rows + 0.5) / finer - K[1, 2]).astype(np.float32) * z / np.float32(K[1, 1])
    return np.stack([R[0] * x + R[1] * y + R[2] * z + R[3] for R in T[:3].astype(np.float32)], axis=1)
