"""The space that the arm itself takes up: known from its joints, and no obstacle to it."""

from __future__ import annotations

import numpy as np

from twin_node.forecast.bits import Bits
from twin_node.forecast.kernel_requests import TakeRequest
from twin_node.forecast.kernels import kernels
from twin_node.geometry import distance_to_segment
from twin_node.native_library import addresses_of
from twin_node.robot import ArmModel, forward_kinematics, place_capsules
from twin_node.scene import Float64, Grid, JointSample

MARGIN = 0.01
"""By which the arm's capsules are grown, m: what mounting and joint stamps leave between model and image."""


def own_space(grid: Grid, arm: ArmModel, joints: JointSample) -> Bits:
    """Voxels that the arm's capsules, grown by `MARGIN`, touch.

    Raises `RobotError` for joint values that are not the arm's.
    """
    placed = place_capsules(arm, forward_kinematics(arm, arm.ordered_positions(joints)))
    return within(grid, placed.ends, placed.radii + MARGIN + grid.voxel_size * np.sqrt(3) / 2)


def within(grid: Grid, ends: Float64, radii: Float64) -> Bits:
    """Voxels whose middles lie in a capsule: ends [C, 2, 3] and radii [C] in metres.

    Compiled; `within_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return within_reference(grid, ends, radii)
    arrays = [np.ascontiguousarray(array, np.float64) for array in (grid.origin, ends, radii)]
    taken = Bits.none(grid.dims)
    compiled.run(TakeRequest(len(radii), *grid.dims, grid.voxel_size, *addresses_of(*arrays, taken.words)))
    return taken


def within_reference(grid: Grid, ends: Float64, radii: Float64) -> Bits:
    """What `within` does."""
    taken = np.zeros(grid.dims, np.bool_)
    for own, radius in zip(ends, radii, strict=True):
        lower = np.floor((own.min(axis=0) - radius - grid.origin) / grid.voxel_size).astype(int)
        upper = np.ceil((own.max(axis=0) + radius - grid.origin) / grid.voxel_size).astype(int)
        start, stop = np.clip(lower, 0, grid.dims), np.clip(upper, 0, grid.dims)
        if np.any(start >= stop):
            continue
        axes = [grid.origin[i] + (np.arange(start[i], stop[i]) + 0.5) * grid.voxel_size for i in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        box = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        taken[box] |= distance_to_segment(points, own) <= radius
    return Bits.of_mask(grid.dims, taken.reshape(-1))
