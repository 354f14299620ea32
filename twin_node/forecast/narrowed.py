"""States in as many pixels as a grid can tell apart: of larger images a forecast would spend its time on the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin_node.scene import Bool, Camera, Grid, TwinState
from twin_node.scene.narrowing import WholeNarrower, narrowed_to

LEAST_WIDTH = 320
"""px: images are made no narrower, however coarse the voxels are: smaller things than these move."""
PIXELS_PER_VOXEL = 2.0
"""Pixels across a voxel in the middle of the grid that are left at least, by which its edges are told."""


class NarrowedStates:
    """Makes the images and masks of states smaller by whole factors, where the voxels of one grid allow for it."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._middle = grid.origin + np.array(grid.dims) * grid.voxel_size / 2
        self._narrower = WholeNarrower()

    def of(self, state: TwinState) -> TwinState:
        """The state before the same cameras with fewer pixels; itself where none has too many, or one has other arrays
        than its size says."""
        seen = list(zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True))
        if any(view.misfit(moving=moving, robot=robot) for view, moving, robot in seen):
            return state
        views = tuple(self._narrower.view(view, self._factor(view.camera)) for view in state.frames.views)
        if all(narrow is wide for narrow, wide in zip(views, state.frames.views, strict=True)):
            return state
        masks = [_masks(narrow.camera, moving, robot) for narrow, (_, moving, robot) in zip(views, seen, strict=True)]
        moving, robots = zip(*masks, strict=True)
        return replace(state, frames=replace(state.frames, views=views), moving_masks=moving, robot_masks=robots)

    def _factor(self, camera: Camera) -> int:
        """How many of a camera's pixels, each way, one may be made of."""
        depth = float((camera.viewmat[:3, :3] @ self._middle + camera.viewmat[:3, 3])[2])
        if depth <= 0:
            return 1
        across = self._grid.voxel_size * camera.K[0, 0] / depth
        return max(min(camera.width // LEAST_WIDTH, int(across / PIXELS_PER_VOXEL)), 1)


def _masks(camera: Camera, moving: Bool, robot: Bool | None) -> tuple[Bool, Bool | None]:
    """Both masks in a narrowed camera's pixels, of which those that hold some of either move."""
    narrow = narrowed_to(camera, moving)
    return narrow, None if robot is None else narrowed_to(camera, robot) & ~narrow
