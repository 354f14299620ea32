"""Solids as one camera sees them: where it is in their frames, and which pixels may show them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.cell.shapes import SIGNS
from twin_node.cell.solids import Solid
from twin_node.geometry import project
from twin_node.scene import Camera, Float32, Float64

_NEAREST_M = 0.05
"""Depth from which on corners are projected: a solid that begins before may be anywhere in the image."""


@dataclass(frozen=True)
class InView:
    """Solids before a camera."""

    solids: tuple[Solid, ...]
    rotations: Float32
    """[S, 3, 3] turn the axes of every shape's frame into those of `base_link`."""
    origins: Float32
    """[S, 3] the camera's centre in the frame of every shape, m."""
    rects: NDArray[np.int32]
    """[S, 4] the pixels that may show each: first column, one past the last, first row, one past the last."""


def in_view(camera: Camera, solids: tuple[Solid, ...]) -> InView:
    """Solids in `base_link` before a camera."""
    poses = np.array([solid.placed.T_base_shape for solid in solids]).reshape(-1, 4, 4)
    rotations, centers = poses[:, :3, :3], poses[:, :3, 3]
    origins = ((camera.T_base_cam[:3, 3] - centers)[:, None] @ rotations)[:, 0]
    half = np.array([solid.placed.shape.half_extents for solid in solids]).reshape(-1, 1, 3)
    corners = (SIGNS * half) @ rotations.transpose(0, 2, 1) + centers[:, None]
    return InView(solids, rotations.astype(np.float32), origins.astype(np.float32), _outlines(camera, corners))


def _outlines(camera: Camera, corners: Float64) -> NDArray[np.int32]:
    """Smallest rectangles [S, 4] of pixels about boxes' corners [S, 8, 3]; the whole image for those that reach the
    camera, no pixel for those behind it."""
    uvz = project(camera.K, camera.viewmat, corners.reshape(-1, 3)).reshape(-1, 8, 3)
    size = np.array([camera.width, camera.height])
    low, high = np.floor(uvz[..., :2].min(axis=1)), np.ceil(uvz[..., :2].max(axis=1))
    nearest, farthest = uvz[..., 2].min(axis=1), uvz[..., 2].max(axis=1)
    low[nearest < _NEAREST_M], high[nearest < _NEAREST_M] = 0, size
    high[farthest <= 0] = 0
    rects = np.stack([low, high], axis=-1).clip(0, size[:, None])
    return np.ascontiguousarray(rects.reshape(-1, 4), np.int32)
