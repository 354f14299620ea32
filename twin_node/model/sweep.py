"""Depth of a first set of colour images: every pixel tries planes parallel to the dominant one, and a far shell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.model.plane import Plane, correlation
from twin_node.model.rays import back_project, look, pixel_rays
from twin_node.scene import Bool, Camera, Float32, Float64, View

CORRELATION_WEIGHT, COLOUR_WEIGHT = 0.5, 4.0
"""A perfect correlation outweighs a colour difference of 1/8 of the range: what specular tables show between views."""
PLANE_BONUS, HEIGHT_PENALTY = 0.4, 0.4
"""What a pixel must gain to leave the dominant plane, and to stand as high as the lowest camera."""
SHELL_SCORE = -0.35
"""Score of the shell, which nothing can disprove: what a colour difference of 0.09 without correlation scores."""
SMOOTH_PX = 7
"""Side of the window over which scores are averaged before the best is taken."""


@dataclass(frozen=True)
class Surface:
    """What one view's pixels show."""

    depth: Float64
    """[H, W] m along the optical axis, everywhere finite and positive."""
    on_plane: Bool
    """[H, W] whether the pixel shows the dominant plane."""


@dataclass(frozen=True)
class Shell:
    """The sphere that stands for everything too far to measure."""

    centre: Float64
    """[3] m: what the rig looks at."""
    radius: float
    """m."""

    def depth(self, camera: Camera) -> Float64:
        """[H, W] m along the optical axis at which each pixel's ray leaves the shell."""
        rays = pixel_rays(camera)
        start = camera.T_base_cam[:3, 3] - self.centre
        a = (rays**2).sum(-1)
        b = rays @ start
        depth: Float64 = (np.sqrt(np.maximum(b**2 - a * (start @ start - self.radius**2), 0)) - b) / a
        return depth


def shell_around(cameras: Sequence[Camera], factor: float) -> Shell:
    """The shell about the point nearest to all optical axes, `factor` times as far as the farthest camera."""
    centres = np.stack([camera.T_base_cam[:3, 3] for camera in cameras])
    axes = np.stack([camera.T_base_cam[:3, 2] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    A = across.sum(0) + 1e-3 * np.eye(3)
    target = np.linalg.solve(A, np.einsum("nij,nj->i", across, centres) + 1e-3 * (centres + axes).mean(0))
    return Shell(target, factor * max(float(np.linalg.norm(centres - target, axis=1).max()), 0.5))


def sweep(views: Sequence[View], plane: Plane, shell: Shell, levels: int) -> list[Surface]:
    """Depth of each view from the other views' agreement; needs no texture where a pixel's surroundings decide."""
    lowest = min(float(plane.height(view.camera.T_base_cam[:3, 3])) for view in views)
    heights = np.unique(np.append(np.linspace(-0.1, 0.9, levels) * lowest, 0.0))
    surfaces = [_sweep_view(views, index, plane, heights, shell) for index in range(len(views))]
    return _close_plane(views, surfaces, plane, shell)


def _sweep_view(views: Sequence[View], index: int, plane: Plane, heights: Float64, shell: Shell) -> Surface:
    view = views[index]
    best = np.full((view.camera.height, view.camera.width), SHELL_SCORE, np.float32)
    depth = shell.depth(view.camera)
    on_plane = np.zeros(best.shape, dtype=bool)
    for height in heights:
        level = plane.shifted(float(height))
        candidate = level.depth(view.camera)
        score = _score(view, [other for i, other in enumerate(views) if i != index], level, candidate)
        score += PLANE_BONUS if height == 0.0 else -HEIGHT_PENALTY * abs(height) / heights[-1]
        better = (score > best) & (candidate > 0.05) & (candidate < shell.depth(view.camera))
        best = np.where(better, score, best)
        depth = np.where(better, candidate, depth)
        on_plane = np.where(better, height == 0.0, on_plane)
    return Surface(depth, on_plane)


def _close_plane(views: Sequence[View], surfaces: list[Surface], plane: Plane, shell: Shell) -> list[Surface]:
    """Pixels left to the shell although the plane's own extent stands before it show the plane or something on it."""
    flat = [
        back_project(view.camera, surface.depth)[surface.on_plane]
        for view, surface in zip(views, surfaces, strict=True)
    ]
    first = np.cross(plane.normal, [1.0, 0.0, 0.0] if abs(plane.normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    axes = np.stack([first, np.cross(plane.normal, first)]).T
    points = np.concatenate(flat) @ axes
    if len(points) < 3:
        return surfaces
    hull = cv2.convexHull(points.astype(np.float32))
    closed = []
    for view, surface in zip(views, surfaces, strict=True):
        depth = plane.depth(view.camera)
        far = np.isfinite(depth) & (depth > 0.05) & (surface.depth >= 0.999 * shell.depth(view.camera))
        hits = (back_project(view.camera, np.where(far, depth, 1.0))[far] @ axes).astype(np.float32)
        far[far] = [cv2.pointPolygonTest(hull, (float(x), float(y)), False) > 0 for x, y in hits]
        closed.append(Surface(np.where(far, depth, surface.depth), surface.on_plane | far))
    return closed


def _score(view: View, others: Sequence[View], level: Plane, depth: Float64) -> Float32:
    """[H, W] how well the best of the other views agrees; -inf where none shares the pixel."""
    points = back_project(view.camera, np.where(np.isfinite(depth), depth, 1.0)).reshape(-1, 3)
    best = np.full(depth.shape, -10.0, np.float32)
    for other in others:
        seen = look(other.camera, points)
        difference = np.abs(other.rgb[seen.rows, seen.columns].astype(np.float32) - view.rgb.reshape(-1, 3)).mean(-1)
        shared = (seen.inside & np.isfinite(depth.ravel())).reshape(depth.shape)
        score = CORRELATION_WEIGHT * np.nan_to_num(correlation(view, other, level), nan=-1.0)
        score -= COLOUR_WEIGHT / 255 * difference.reshape(depth.shape)
        best = np.maximum(best, np.where(shared, score, -10.0))
    smooth: Float32 = cv2.blur(best, (SMOOTH_PX, SMOOTH_PX)).astype(np.float32)
    return smooth
