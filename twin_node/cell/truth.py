"""What is exactly so in the simulated cell: moving voxels and masks at any time."""

from __future__ import annotations

import numpy as np

from twin_node.cell.shapes import touched_voxels
from twin_node.cell.simulator import SimulatedRig
from twin_node.scene import Bool, Float64, Grid, Occupancy, OccupancyLayer, UInt32


class CellTruth:
    """Exact answers about a simulated cell."""

    def __init__(self, simulated: SimulatedRig) -> None:
        self._simulated = simulated
        self._world = simulated.world
        scenario = simulated.scenario
        self.grid = workspace_grid(np.array(scenario.workspace), scenario.voxel_size_m)
        """The workspace in voxels of the scenario's size."""

    def moving_voxels(self, grid: Grid, stamp: int) -> UInt32:
        """Flat indices, increasing, of voxels whose cube meets a moving body or person; the arm left out."""
        parts = [touched_voxels(solid.placed, grid) for solid in self._world.moving(stamp)]
        return np.unique(np.concatenate([np.empty(0, np.int64), *parts])).astype(np.uint32)

    def occupancy(self, stamp: int) -> Occupancy:
        """The moving voxels of `self.grid` at a stamp as one certain layer; static and unknown space are left empty."""
        nothing = OccupancyLayer(0, np.empty(0, np.uint32), np.empty(0, np.uint8))
        indices = self.moving_voxels(self.grid, stamp)
        layer = OccupancyLayer(0, indices, np.full(len(indices), 255, np.uint8))
        return Occupancy(stamp, stamp, self.grid, (layer,), nothing, np.empty((0, 2), np.uint32))

    def moving_mask(self, camera: int, stamp: int) -> Bool:
        """[H, W] True where a camera of the rig sees a moving body or person."""
        return self._simulated.see(camera, stamp).shows(self._world.moving_owners)

    def arm_mask(self, camera: int, stamp: int) -> Bool:
        """[H, W] True where a camera of the rig sees the arm."""
        return self._simulated.see(camera, stamp).shows((self._world.arm_owner,) if self._world.arm else ())


def workspace_grid(workspace: Float64, voxel_size: float) -> Grid:
    """The smallest grid of whole voxels over a box [2, 3] (lower and upper corner, m)."""
    dims = np.ceil((workspace[1] - workspace[0]) / voxel_size - 1e-6).astype(int)
    return Grid(workspace[0].astype(np.float64), voxel_size, (int(dims[0]), int(dims[1]), int(dims[2])))
