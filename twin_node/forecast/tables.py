"""Where each camera sees each voxel: computed once per calibration, read for every image set."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.kernel_requests import BlockSightings as SightingsRequest
from twin_node.forecast.kernel_requests import Table as TableRequest
from twin_node.geometry import project
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Camera, Float32, Float64, Grid

Number = TypeVar("Number", np.float32, np.int32)

BLOCK = 4
"""Voxels along a side of a block: whole blocks are decided first, their voxels where that fails."""
VOXELS = BLOCK**3
"""Voxels per block."""
NOWHERE = np.float32(1e6)
"""Depth of pixels that show none of some voxels, m."""
HOUSING_M = 0.2
"""What stands nearer to a camera than this may be its own housing, as others measure it: it hides little, m."""


class Blocks:
    """The grid's voxels in blocks of `BLOCK`^3, padded at the upper ends."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.dims = np.array([-(-n // BLOCK) for n in grid.dims])
        self.count = int(self.dims.prod())
        self._offsets: NDArray[np.int64] = np.stack(np.unravel_index(np.arange(VOXELS), (BLOCK,) * 3), axis=1)

    def corners(self, blocks: NDArray[np.int64]) -> NDArray[np.int64]:
        """First voxel (i, j, k) [n, 3] of blocks [n]."""
        return np.stack(np.unravel_index(blocks, tuple(self.dims)), axis=1) * BLOCK

    def places(self, blocks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Places of the voxels of blocks [n] in tables of `count * VOXELS` entries; padding is left out."""
        places: NDArray[np.int64] = (blocks[:, None] * VOXELS + np.arange(VOXELS)).ravel()
        return places[self._inside[places]]

    def indices(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Flat voxel indices [n] of places [n]: what `locate` undoes."""
        _, ny, nz = self.grid.dims
        strides = np.array([ny * nz, nz, 1])
        blocks, offsets = np.divmod(places, VOXELS)
        indices: NDArray[np.int64] = self.corners(blocks) @ strides + (self._offsets @ strides)[offsets]
        return indices

    def locate(self, indices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Places [n] of flat voxel indices [n] in tables of `count * VOXELS` entries."""
        places: NDArray[np.int64] = self._places[indices]
        return places

    @cached_property
    def _places(self) -> NDArray[np.int64]:
        """[grid.size] of all voxels."""
        all_places = self.places(np.arange(self.count))
        located = np.empty(self.grid.size, np.int64)
        located[self.indices(all_places)] = all_places
        return located

    @cached_property
    def _inside(self) -> Bool:
        """[count * VOXELS] False for the padding beyond the grid's upper ends."""
        ijk = self.corners(np.arange(self.count))[:, None] + self._offsets
        return np.asarray((ijk < np.array(self.grid.dims)).all(axis=2).ravel())

    @cached_property
    def voxel_centers(self) -> Float64:
        """[count * VOXELS, 3] m."""
        ijk = self.corners(np.arange(self.count))[:, None] + self._offsets
        return self.grid.origin + (ijk.reshape(-1, 3) + 0.5) * self.grid.voxel_size

    @property
    def centers(self) -> Float64:
        """[count, 3] m."""
        return self.grid.origin + (self.corners(np.arange(self.count)) + BLOCK / 2) * self.grid.voxel_size

    def members_of_large(self) -> NDArray[np.int64]:
        """[large, 8] blocks in each block of two by two by two of them, row by row; -1 beyond the upper ends."""
        padded = np.full(2 * (-(-self.dims // 2)), -1)
        padded[tuple(slice(n) for n in self.dims)] = np.arange(self.count).reshape(self.dims)
        x, y, z = padded.shape
        return padded.reshape(x // 2, 2, y // 2, 2, z // 2, 2).transpose(0, 2, 4, 1, 3, 5).reshape(-1, 8)

    def inside(self) -> Bool:
        """[count, VOXELS] False for the padding beyond the grid's upper ends."""
        return self._inside.reshape(self.count, VOXELS)


@dataclass(frozen=True)
class Sighting:
    """Where a camera sees points."""

    pixels: NDArray[np.int32]
    """Flat pixels; `width * height` where outside the image."""
    depth: Float32
    """m along the optical axis; 0 behind the camera."""


@dataclass(frozen=True)
class BlockSightings:
    """Where a camera sees whole blocks."""

    near: Float32
    """[count] least depth of a voxel, m."""
    far: Float32
    """[count] greatest depth of a voxel, m."""
    windows: NDArray[np.int32]
    """[count, 4] first and last column, first and last row of their pixels; last before first where there are none."""
    whole: Bool
    """[count] True where all voxels lie inside the image."""


class BlocksSeen(NamedTuple):
    """Where a camera sees blocks."""

    small: BlockSightings
    large: BlockSightings
    """Of `Blocks.members_of_large`."""


class CameraTable:
    """Where a camera sees every voxel and block; pixel `width * height` stands for outside the image."""

    def __init__(self, camera: Camera, blocks: Blocks) -> None:
        self.camera = camera
        self.outside = camera.width * camera.height
        self._blocks = blocks
        self.voxels = self._sight(blocks.voxel_centers)
        """Of all voxels, block by block."""
        small = self._sight_blocks()
        self.of_blocks = BlocksSeen(small, _joined(small, blocks.members_of_large()))
        """The same of whole blocks."""
        distance = float(np.linalg.norm(blocks.centers.mean(axis=0) - camera.T_base_cam[:3, 3]))
        self.pixels_per_metre = camera.K[0, 0] / max(distance, blocks.grid.voxel_size)

    @cached_property
    def request(self) -> TableRequest:
        """The addresses of what it says of voxels, small and large blocks: good for as long as it lives."""
        voxels = addresses_of(self.voxels.pixels, self.voxels.depth)
        arrays = ((blocks.near, blocks.far, blocks.windows, blocks.whole) for blocks in self.of_blocks)
        return TableRequest(*voxels, *(SightingsRequest(*addresses_of(*own)) for own in arrays))

    def belongs_to(self, camera: Camera) -> bool:
        """Whether the calibration is still the one that the table was made for."""
        mine = self.camera
        if mine is camera:
            return True
        same_image = (mine.width, mine.height) == (camera.width, camera.height)
        return same_image and np.array_equal(mine.K, camera.K) and np.array_equal(mine.T_base_cam, camera.T_base_cam)

    def at(self, places: NDArray[np.int64]) -> Sighting:
        """The voxels at `places` [n] (`Blocks.locate`)."""
        return Sighting(self.voxels.pixels[places], self.voxels.depth[places])

    def image_of(self, places: NDArray[np.int64]) -> Bool:
        """[H, W] True where the voxels at `places` project, each as large as a voxel in the middle of the grid."""
        hit = np.zeros(self.outside + 1, np.uint8)
        hit[self.voxels.pixels[places]] = 1
        image = hit[:-1].reshape(self.camera.height, self.camera.width)
        return cv2.dilate(image, self._voxel()) > 0

    def fronts_of(self, places: NDArray[np.int64], are_measured: bool = True) -> Float32:
        """[H, W] depth (m) at which the nearest of the voxels at `places` begins; `NOWHERE` where there is none.

        Each is as large as a voxel in the middle of the grid; those that `are_measured` no smaller than the box about
        them in the image: between near ones there are no gaps.
        """
        seen = self.at(places[self.voxels.pixels[places] < self.outside])
        begins = seen.depth - np.float32(self._blocks.grid.voxel_size / 2)
        sides = self._sides(seen.depth) if are_measured else np.full(len(begins), len(self._voxel()))
        fronts = np.full((self.camera.height, self.camera.width), NOWHERE, np.float32)
        for side in np.unique(sides).tolist():
            mine = np.flatnonzero(sides == side)
            mine = mine[np.argsort(-seen.depth[mine], kind="stable")]  # of several in a pixel the last one stays
            nearest = np.full(self.outside, NOWHERE, np.float32)
            nearest[seen.pixels[mine]] = begins[mine]
            drawn = cv2.erode(nearest.reshape(fronts.shape), np.ones((side, side), np.uint8))
            np.minimum(fronts, drawn, out=fronts)
        return fronts

    def _sides(self, depth: Float32) -> NDArray[np.int64]:
        """Sides [n] in pixels, odd, of squares that hold voxels at a depth [n] (m)."""
        camera, middle = self.camera, len(self._voxel())
        turned = np.abs(camera.viewmat[:2, :3]).sum(axis=1)  # of the box about a cube of side 1
        largest = max(camera.K[0, 0] * turned[0], camera.K[1, 1] * turned[1]) * self._blocks.grid.voxel_size
        pixels = np.where(depth < HOUSING_M, 0, largest / np.maximum(depth, HOUSING_M))
        return np.maximum(2 * np.ceil((pixels - 1) / 2).astype(np.int64) + 1, middle)

    def _voxel(self) -> NDArray[np.uint8]:
        """Pixels of a voxel in the middle of the grid, as a kernel."""
        size = 2 * round(self.pixels_per_metre * self._blocks.grid.voxel_size / 2) + 1
        return np.ones((size, size), np.uint8)

    def _sight(self, points: Float64) -> Sighting:
        u, v, z = project(self.camera.K, self.camera.viewmat, points).T
        width, height = self.camera.width, self.camera.height
        inside = (z > 1e-3) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        column, row = np.where(inside, u, 0).astype(np.int32), np.where(inside, v, 0).astype(np.int32)
        pixels = np.where(inside, row * width + column, self.outside).astype(np.int32)
        return Sighting(pixels, np.maximum(z, 0).astype(np.float32))

    def _sight_blocks(self) -> BlockSightings:
        real = self._blocks.inside()
        depths, pixels = self.voxels.depth.reshape(real.shape), self.voxels.pixels.reshape(real.shape)
        shown = real & (pixels < self.outside)
        rows, columns = np.divmod(pixels, self.camera.width)
        ends = [end(axis, shown) for axis in (columns, rows) for end in (_least, _greatest)]
        windows = np.stack(ends, axis=1).astype(np.int32)
        whole: Bool = np.all(shown | ~real, axis=1)
        return BlockSightings(_least(depths, real), _greatest(depths, real), windows, whole)


def _joined(blocks: BlockSightings, members: NDArray[np.int64]) -> BlockSightings:
    """Of blocks that each consist of some of `blocks`, those in a row of `members` [n, m] that are not -1."""
    there = members >= 0
    ends = blocks.windows[members]
    windows = np.stack([end(ends[..., k], there) for k, end in enumerate((_least, _greatest) * 2)], axis=1)
    return BlockSightings(
        _least(blocks.near[members], there),
        _greatest(blocks.far[members], there),
        windows,
        np.all(blocks.whole[members] | ~there, axis=1),
    )


def _least(values: NDArray[Number], chosen: Bool) -> NDArray[Number]:
    """[n] least of the chosen values [n, m] in each row; more than any where there are none."""
    least: NDArray[Number] = np.where(chosen, values, values.max(initial=0) + 1).min(axis=1)
    return least


def _greatest(values: NDArray[Number], chosen: Bool) -> NDArray[Number]:
    """[n] greatest of the chosen values [n, m] in each row, which are not negative; -1 where there are none."""
    greatest: NDArray[Number] = np.where(chosen, values, np.full_like(values, -1)).max(axis=1)
    return greatest


class RigTables:
    """The tables of all cameras of a rig over one grid."""

    def __init__(self, grid: Grid) -> None:
        self.blocks = Blocks(grid)
        self._tables: dict[str, CameraTable] = {}
        self._asked: dict[str, Camera] = {}
        """By name, the camera that its table was asked for last."""

    def of(self, camera: Camera) -> CameraTable:
        """The camera's table, made on its first sight and when its calibration changes."""
        if self._asked.get(camera.name) is not camera:
            table = self._tables.get(camera.name)
            if table is None or not table.belongs_to(camera):
                self._tables[camera.name] = CameraTable(camera, self.blocks)
            self._asked[camera.name] = camera
        return self._tables[camera.name]
