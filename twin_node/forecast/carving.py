"""Which voxels the cameras free, which hold what moves, and which nobody sees: the carving rules."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import project
from twin_node.scene import Bool, Camera, Float32, Float64, Grid, TwinState, UInt8, View

BLOCK = 4
"""Voxels along a side of a block: whole blocks are decided first, their voxels where that fails."""
_VOXELS = BLOCK**3
_REACHES = (2, 4, 8, 16, 32, 64)
"""Half widths in pixels of the neighbourhoods that stand for a block's image."""
_NEVER = np.float32(0)
_ALWAYS = np.float32(1e6)
_MOVING, _ROBOT, _SEEN = np.uint8(1), np.uint8(2), np.uint8(4)


@dataclass(frozen=True)
class CarvingParameters:
    """How far a camera is trusted to free space."""

    sigmas: float = 2.0
    """Calibration error that the moving mask is widened by, in sigmas of `Camera.sigma_m`."""
    assumed_sigma_m: float = 0.015
    """Calibration error ascribed to cameras whose own is unknown, m: a careful board calibration at 2 to 4 m."""
    depth_margin: float = 0.015
    """Space is freed up to this far in front of a measured surface, m, plus `depth_share` of its depth."""
    depth_share: float = 0.01
    """Depth error as a share of depth."""
    thickness: float = 0.3
    """Depth behind a measured moving surface that may belong to the thing, m; a torso from front to back."""


@dataclass(frozen=True)
class Carved:
    """What one set of images says about every voxel; voxels in neither list are free."""

    moving: NDArray[np.int64]
    """[n] flat indices of what may move, strictly increasing."""
    unknown: NDArray[np.int64]
    """[m] flat indices that nothing frees and nothing explains, strictly increasing."""


class Carver:
    """Carves one grid with the views of a rig; what depends on the calibration alone is computed once per camera."""

    def __init__(self, grid: Grid, parameters: CarvingParameters | None = None) -> None:
        self.grid = grid
        self.parameters = parameters or CarvingParameters()
        self._blocks = _Blocks(grid)
        self._tables: dict[str, _CameraTable] = {}

    def carve(self, state: TwinState, speed: float) -> Carved:
        """Moving and unknown voxels of a state; `speed` (m/s) is how fast things may move between unequal stamps."""
        sights = self._sights(state, speed)
        return self._decide(self._undecided_blocks(sights), sights)

    def frees(self, state: TwinState, indices: NDArray[np.int64]) -> Bool:
        """Whether some camera frees each of the voxels `indices` [n]."""
        blocks, places = self._blocks.locate(indices)
        freed = np.zeros(len(indices), np.bool_)
        for sight in self._sights(state, 0.0):
            freed |= sight.table.depth[blocks, places] < sight.free_until[sight.table.pixels[blocks, places]]
        return freed

    def _sights(self, state: TwinState, speed: float) -> list[_Sight]:
        sights = []
        for view, moving, robot in zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True):
            table = self._table(view.camera)
            error = self.parameters.sigmas * (view.camera.sigma_m or self.parameters.assumed_sigma_m)
            error += abs(state.stamp - view.stamp) * 1e-9 * speed
            pixels = error * table.pixels_per_metre
            sights.append(_Sight(table, view, moving, robot, error_pixels=pixels, parameters=self.parameters))
        return sights

    def _table(self, camera: Camera) -> _CameraTable:
        table = self._tables.get(camera.name)
        if table is None or not table.belongs_to(camera):
            table = self._tables[camera.name] = _CameraTable(camera, self._blocks)
        return table

    def _undecided_blocks(self, sights: list[_Sight]) -> NDArray[np.int64]:
        """Blocks that no camera frees as a whole."""
        undecided = np.ones(self._blocks.count, np.bool_)
        for sight in sights:
            undecided &= ~sight.frees_blocks()
        return np.flatnonzero(undecided)

    def _decide(self, blocks: NDArray[np.int64], sights: list[_Sight]) -> Carved:
        """Every voxel of these blocks against every camera."""
        shape = (len(blocks), _VOXELS)
        freed = self._blocks.outside_grid(blocks)
        moving_views, robot_views, seen_views = np.zeros((3, *shape), np.uint8)
        surface_views = np.zeros(shape, np.bool_)
        for sight in sights:
            pixels, depth = sight.table.pixels[blocks], sight.table.depth[blocks]
            freed |= depth < sight.free_until[pixels]
            flags = sight.flags[pixels]
            moving_views += flags & _MOVING
            robot_views += (flags & _ROBOT) // _ROBOT
            seen_views += (flags & _SEEN) // _SEEN
            if sight.moving_until is not None:
                surface_views |= depth < sight.moving_until[pixels]
        moving = ~freed & ((moving_views >= 2) | surface_views)
        robot_itself = (robot_views >= 2) & (robot_views == seen_views)
        unknown = ~freed & ~moving & ~robot_itself
        indices = self._blocks.indices(blocks)
        return Carved(np.sort(indices[moving]), np.sort(indices[unknown]))


class _Blocks:
    """The grid's voxels in blocks of `BLOCK`^3, padded at the upper ends."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.dims = np.array([-(-n // BLOCK) for n in grid.dims])
        self.count = int(self.dims.prod())
        offsets = np.stack(np.unravel_index(np.arange(_VOXELS), (BLOCK,) * 3), axis=1)
        self._offsets: NDArray[np.int64] = offsets

    def corners(self, blocks: NDArray[np.int64]) -> NDArray[np.int64]:
        """First voxel (i, j, k) [n, 3] of blocks [n]."""
        return np.stack(np.unravel_index(blocks, tuple(self.dims)), axis=1) * BLOCK

    def indices(self, blocks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Flat voxel indices [n, BLOCK^3]; meaningless where `outside_grid`."""
        _, ny, nz = self.grid.dims
        strides = np.array([ny * nz, nz, 1])
        indices: NDArray[np.int64] = (self.corners(blocks) @ strides)[:, None] + self._offsets @ strides
        return indices

    def locate(self, indices: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Block, and place within the block, of flat voxel indices [n]."""
        ijk = np.stack(np.unravel_index(indices, self.grid.dims))
        block = np.ravel_multi_index(tuple(ijk // BLOCK), tuple(self.dims))
        return block, np.ravel_multi_index(tuple(ijk % BLOCK), (BLOCK,) * 3)

    def outside_grid(self, blocks: NDArray[np.int64]) -> Bool:
        """[n, BLOCK^3] True for the padding beyond the grid's upper ends."""
        corners = self.corners(blocks)
        outside = np.zeros((len(blocks), _VOXELS), np.bool_)
        for axis, size in enumerate(self.grid.dims):
            outside |= corners[:, axis : axis + 1] + self._offsets[:, axis] >= size
        return outside

    @cached_property
    def voxel_centers(self) -> Float64:
        """[count * BLOCK^3, 3] m."""
        ijk = self.corners(np.arange(self.count))[:, None] + self._offsets
        return self.grid.origin + (ijk.reshape(-1, 3) + 0.5) * self.grid.voxel_size

    @property
    def centers(self) -> Float64:
        """[count, 3] m."""
        return self.grid.origin + (self.corners(np.arange(self.count)) + BLOCK / 2) * self.grid.voxel_size


class _CameraTable:
    """Where a camera sees every voxel and block; pixel `width * height` stands for outside the image."""

    def __init__(self, camera: Camera, blocks: _Blocks) -> None:
        self.camera = camera
        self.outside = camera.width * camera.height
        flat, depth = self._project(blocks.voxel_centers)
        self.pixels = flat.reshape(blocks.count, _VOXELS)
        self.depth = depth.reshape(blocks.count, _VOXELS)
        self.block_pixels, block_depth = self._project(blocks.centers)
        radius = np.sqrt(3) / 2 * BLOCK * blocks.grid.voxel_size
        self.block_far = block_depth + np.float32(radius)
        near = np.maximum(block_depth - radius, 1e-3)
        reach = np.ceil(camera.K[:2, :2].max() * radius / near * 1.5) + 1
        self.block_reach = np.searchsorted(np.array(_REACHES), reach)
        distance = float(np.linalg.norm(blocks.centers.mean(axis=0) - camera.T_base_cam[:3, 3]))
        self.pixels_per_metre = camera.K[0, 0] / max(distance, blocks.grid.voxel_size)

    def belongs_to(self, camera: Camera) -> bool:
        """Whether the calibration is still the one that the table was made for."""
        mine = self.camera
        same_image = (mine.width, mine.height) == (camera.width, camera.height)
        same_pose = np.array_equal(mine.K, camera.K) and np.array_equal(mine.T_base_cam, camera.T_base_cam)
        return mine is camera or (same_image and same_pose)

    def _project(self, points: Float64) -> tuple[NDArray[np.int32], Float32]:
        """Flat pixel and depth of points [n, 3]."""
        u, v, z = project(self.camera.K, self.camera.viewmat, points).T
        width, height = self.camera.width, self.camera.height
        inside = (z > 1e-3) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        column, row = np.where(inside, u, 0).astype(np.int32), np.where(inside, v, 0).astype(np.int32)
        return np.where(inside, row * width + column, self.outside).astype(np.int32), z.astype(np.float32)


class _Sight:
    """What one view says along the ray of every pixel, flat, with one more entry for outside the image."""

    def __init__(
        self,
        table: _CameraTable,
        view: View,
        moving: Bool,
        robot: Bool | None,
        *,
        error_pixels: float,
        parameters: CarvingParameters,
    ) -> None:
        self.table = table
        seen = np.ones(moving.shape, np.bool_) if view.valid is None else view.valid
        blind = ~seen if robot is None else ~seen | robot
        widened = _dilate(moving, error_pixels)
        self.free_image = _free_until(view, widened | blind, blind, error_pixels, parameters)
        self.free_until = np.append(self.free_image, _NEVER)
        flags = (widened & ~blind) * _MOVING + seen * _SEEN
        if robot is not None:
            flags += (robot & seen) * _ROBOT
        self.flags = np.append(flags, np.uint8(0))
        self.moving_until = _moving_until(view, moving & ~blind, parameters)

    def frees_blocks(self) -> Bool:
        """[blocks] True where every voxel of the block is freed."""
        frees = np.zeros(len(self.table.block_far), np.bool_)
        for level, reach in enumerate(_REACHES):
            mine = np.flatnonzero((self.table.block_reach == level) & (self.table.block_pixels < self.table.outside))
            if len(mine) == 0:
                continue
            least = cv2.erode(self.free_image, np.ones((2 * reach + 1,) * 2, np.uint8), borderValue=0)
            frees[mine] = self.table.block_far[mine] < least.ravel()[self.table.block_pixels[mine]]
        return frees


def _free_until(view: View, moving: Bool, blind: Bool, error_pixels: float, parameters: CarvingParameters) -> Float32:
    """[H, W] depth up to which each pixel frees its ray, m."""
    if view.depth is None:
        return np.where(moving, _NEVER, _ALWAYS).astype(np.float32)
    surface = view.depth * (1 - parameters.depth_share) - parameters.depth_margin
    free = np.where((view.depth > 0) & ~blind, surface, _NEVER).astype(np.float32)
    return cv2.erode(free, _disk(error_pixels)) if error_pixels >= 0.5 else free


def _moving_until(view: View, moving: Bool, parameters: CarvingParameters) -> Float32 | None:
    """Flat depth up to which a measured moving surface explains its ray, with the entry for outside; None: no depth."""
    if view.depth is None:
        return None
    return np.append(np.where(moving & (view.depth > 0), view.depth + parameters.thickness, _NEVER), _NEVER)


def _dilate(mask: Bool, pixels: float) -> Bool:
    return cv2.dilate(mask.astype(np.uint8), _disk(pixels)) > 0 if pixels >= 0.5 else mask


def _disk(radius: float) -> UInt8:
    size = 2 * round(radius) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)).astype(np.uint8)
