"""A ray caster for primitive solids: no graphics driver, the same bytes on every run.

Furniture is cast once per camera; each image casts only the rays inside the projected outline of every moving solid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.cell.shapes import Placed, normals, ray_entries
from twin_node.cell.solids import Solid
from twin_node.cell.textures import colors
from twin_node.geometry import project
from twin_node.scene import Bool, Camera, Float32, UInt8

LIGHTS = ((0.45, (0.35, -0.45, 0.82)), (0.25, (-0.55, 0.6, 0.58)))
"""Strength and direction towards each lamp in `base_link`: a key light above the front right, a fill at the back."""

AMBIENT = 0.45
"""Light from everywhere, as a share of full brightness."""

BACKDROP = (178, 184, 190)
"""R, G, B where no solid is."""

TEXTURE_DEPTH = 0.002
"""m under the surface where solid textures are read, so that faces that lie on a pattern's joint do not flicker."""

NOTHING = -1
"""Owner of the pixels that show no solid."""


@dataclass(frozen=True)
class Rendering:
    """A noiseless image."""

    rgb: UInt8
    """[H, W, 3]."""
    depth: Float32
    """[H, W] metres along the optical axis; 0 where no solid is."""
    owners: NDArray[np.int16]
    """[H, W] `Solid.owner` of the solid in view, `NOTHING` for none."""

    def shows(self, owners: tuple[int, ...]) -> Bool:
        """[H, W] True on the solids of these owners."""
        mask: Bool = np.isin(self.owners, owners)
        return mask


@dataclass(frozen=True)
class _Rect:
    """Rows and columns of an image."""

    rows: slice
    columns: slice


@dataclass
class _Canvas:
    """An image being drawn."""

    rgb: Float32
    """[3, H, W] 0 to 255."""
    depth: Float32
    """[H, W] m, infinite where nothing was hit."""
    owners: NDArray[np.int16]

    def copy(self) -> _Canvas:
        return _Canvas(self.rgb.copy(), self.depth.copy(), self.owners.copy())


class RayCaster:
    """Renders one camera's view of a cell: fixed furniture, and what moves in front of it."""

    def __init__(self, camera: Camera, furniture: tuple[Solid, ...]) -> None:
        self.camera = camera
        u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        pixels = np.stack([u, v, np.ones_like(u)]).reshape(3, -1)
        rays = camera.T_base_cam[:3, :3] @ np.linalg.inv(camera.K) @ pixels
        self._origin = camera.T_base_cam[:3, 3]
        self._viewmat = camera.viewmat
        self._rays: Float32 = rays.astype(np.float32).reshape(3, camera.height, camera.width)
        """Directions in `base_link` whose component along the optical axis is 1, so that ray parameters are depths."""
        self._background = self._empty_canvas()
        for solid in furniture:
            self._draw(solid, self._background)

    def render(self, moving: tuple[Solid, ...]) -> Rendering:
        """The view with these solids added to the furniture."""
        canvas = self._background.copy()
        for solid in moving:
            self._draw(solid, canvas)
        rgb = np.clip(canvas.rgb + 0.5, 0, 255).astype(np.uint8)
        depth = np.where(np.isfinite(canvas.depth), canvas.depth, np.float32(0))
        return Rendering(np.ascontiguousarray(np.moveaxis(rgb, 0, -1)), depth, canvas.owners)

    def _empty_canvas(self) -> _Canvas:
        size = (self.camera.height, self.camera.width)
        rgb = np.empty((3, *size), np.float32)
        rgb[:] = np.array(BACKDROP, np.float32)[:, None, None]
        return _Canvas(rgb, np.full(size, np.inf, np.float32), np.full(size, NOTHING, np.int16))

    def _draw(self, solid: Solid, canvas: _Canvas) -> None:
        rect = self._outline(solid.placed)
        if rect is None:
            return
        R = solid.placed.T_base_shape[:3, :3].astype(np.float32)
        origin = ((self._origin - solid.placed.T_base_shape[:3, 3]) @ R).astype(np.float32)
        rays = self._rays[:, rect.rows, rect.columns]
        local = R.T @ rays.reshape(3, -1)
        entries = ray_entries(solid.placed.shape, origin, local)
        depth = canvas.depth[rect.rows, rect.columns]
        nearer = entries.reshape(depth.shape) < depth
        hit = np.flatnonzero(nearer)
        if not len(hit):
            return
        t = entries[hit]
        points = origin[:, None] + t * local[:, hit]
        facing = normals(solid.placed.shape, points)
        color = colors(solid.texture, points - np.float32(TEXTURE_DEPTH) * facing) * _brightness(R @ facing)
        depth[nearer] = t
        canvas.owners[rect.rows, rect.columns][nearer] = solid.owner
        canvas.rgb[:, rect.rows, rect.columns][:, nearer] = color

    def _outline(self, placed: Placed) -> _Rect | None:
        """Smallest rectangle of pixels that holds the solid's box; the whole image where that reaches the camera."""
        uvz = project(self.camera.K, self._viewmat, placed.corners)
        if uvz[:, 2].max() <= 0:
            return None
        if uvz[:, 2].min() < 0.05:
            return _Rect(slice(0, self.camera.height), slice(0, self.camera.width))
        left, top = np.floor(uvz[:, :2].min(axis=0)).astype(int).clip(0)
        right, bottom = np.ceil(uvz[:, :2].max(axis=0)).astype(int).clip(0)
        if left >= self.camera.width or top >= self.camera.height or right <= 0 or bottom <= 0:
            return None
        return _Rect(slice(top, min(bottom, self.camera.height)), slice(left, min(right, self.camera.width)))


def _brightness(facing: Float32) -> Float32:
    """Lambert shading [n] of unit normals [3, n] in `base_link`, without shadows."""
    light = np.full(facing.shape[1], AMBIENT, np.float32)
    for strength, direction in LIGHTS:
        light += np.float32(strength) * np.maximum(np.array(direction, np.float32) @ facing, 0)
    return light
