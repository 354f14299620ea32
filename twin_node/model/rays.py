"""Pixels as rays of the base frame, and points as pixels: the geometry shared by seeding, births and carving."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import project
from twin_node.model.points import find_pixels, has_points
from twin_node.scene import Bool, Camera, Float64


def pixel_rays(camera: Camera) -> Float64:
    """Directions [H, W, 3] in `base_link` of the pixels' centres, of length one along the optical axis.

    A point at depth z (m) on a pixel's ray is `camera.T_base_cam[:3, 3] + z * ray`.
    """
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    x = (u - camera.K[0, 2]) / camera.K[0, 0]
    y = (v - camera.K[1, 2]) / camera.K[1, 1]
    rays: Float64 = np.stack([x, y, np.ones_like(x)], -1) @ camera.T_base_cam[:3, :3].T
    return rays


def back_project(camera: Camera, depth: NDArray[np.floating]) -> Float64:
    """Base-frame points [H, W, 3] of a depth image [H, W] in m."""
    points: Float64 = camera.T_base_cam[:3, 3] + pixel_rays(camera) * depth[..., None]
    return points


def points_at(camera: Camera, rows: NDArray[np.intp], columns: NDArray[np.intp], depth: Float64) -> Float64:
    """Base-frame points [3, n] (m) of the pixels at `rows` and `columns` [n] at their depth [n] (m)."""
    x = (columns + 0.5 - camera.K[0, 2]) / camera.K[0, 0] * depth
    y = (rows + 0.5 - camera.K[1, 2]) / camera.K[1, 1] * depth
    points: Float64 = camera.T_base_cam[:3, :3] @ np.stack([x, y, depth]) + camera.T_base_cam[:3, 3:]
    return points


@dataclass(frozen=True)
class Seen:
    """Where points fall in one camera's image."""

    columns: NDArray[np.int64]
    """[n] clipped to the image."""
    rows: NDArray[np.int64]
    """[n] clipped to the image."""
    depth: Float64
    """[n] m along the optical axis."""
    inside: Bool
    """[n] whether the point is in front of the camera and inside its image."""

    def of(self, chosen: NDArray[np.int64]) -> Seen:
        """Those `chosen` [k] of the points."""
        return Seen(self.columns[chosen], self.rows[chosen], self.depth[chosen], self.inside[chosen])

    def within(self, mask: Bool) -> Bool:
        """[n] what `mask` [H, W] says at the points' pixels; by one index in a third of the time that two take."""
        own: Bool = mask.ravel().take(self.rows * mask.shape[1] + self.columns)
        return own


def look(camera: Camera, points: NDArray[np.floating]) -> Seen:
    """Pixels that hold base-frame points [n, 3]."""
    if has_points():
        pixels = find_pixels(points, camera.viewmat, camera.K, camera.width, camera.height)
        return Seen(pixels.columns, pixels.rows, pixels.depths, pixels.inside)
    uvz = project(camera.K, camera.viewmat, points)
    column, row = np.floor(np.clip(uvz[:, :2], -1e6, 1e6)).astype(np.int64).T
    in_image = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return Seen(
        np.clip(column, 0, camera.width - 1),
        np.clip(row, 0, camera.height - 1),
        uvz[:, 2],
        in_image & (uvz[:, 2] > 0.02),
    )
