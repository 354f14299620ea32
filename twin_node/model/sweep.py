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
"""A perfect correlation outweighs a colour difference of 1/8 of the range: what gloss makes between views."""
PLANE_BONUS, HEIGHT_PENALTY = 0.4, 0.4
"""What a pixel must gain to leave the dominant plane, and to stand as high as the lowest camera."""
SHELL_SCORE = -0.35
"""Score of the shell, which nothing can disprove: what a colour difference of 0.09 without correlation scores."""
SMOOTH_PX = 7
"""Side of the window over which scores are averaged before the best is taken."""

DISPUTED = 0.2
"""Mean channel difference (0 to 1) from every other view at which a pixel cannot be part of the plane: more than gloss
and exposure make of one surface."""
RAY_SAMPLES = 32
"""Depths tried for a pixel that stands before the plane."""


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
    closed = _close_plane(views, surfaces, plane, shell)
    return [_raise_disputed(views, index, surface) for index, surface in enumerate(closed)]


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


def _raise_disputed(views: Sequence[View], index: int, surface: Surface) -> Surface:
    """Pixels on the plane whose colour no other view sees there stand before it, at the depth where colours agree best.

    Where no depth agrees, a depth that no other view sees is taken before one that another view contradicts.
    """
    camera, image = views[index].camera, views[index].rgb
    others = [view for i, view in enumerate(views) if i != index]
    rows, columns = np.nonzero(surface.on_plane)
    rgb = image[rows, columns].astype(np.float32)
    points = back_project(camera, surface.depth)[rows, columns]
    nearest = np.min([_colour_difference(other, points, rgb, slack=1) for other in others], axis=0)
    strong = np.zeros(surface.on_plane.shape, np.uint8)
    strong[rows, columns] = np.isfinite(nearest) & (nearest > DISPUTED)
    disputed = cv2.medianBlur(strong, 5)[rows, columns] > 0
    rows, columns, rgb = rows[disputed], columns[disputed], rgb[disputed]
    shares = np.linspace(0.95, 0.2, RAY_SAMPLES)
    cost = np.empty((RAY_SAMPLES, len(rows)))
    for step, share in enumerate(shares):
        points = back_project(camera, surface.depth * share)[rows, columns]
        differences = np.stack([_colour_difference(other, points, rgb, slack=0) for other in others])
        worst = np.where(np.isfinite(differences), differences, -1.0).max(0)
        cost[step] = np.where(worst < 0, DISPUTED, worst)
    depth, on_plane = surface.depth.copy(), surface.on_plane.copy()
    if len(rows):
        depth[rows, columns] *= shares[cost.argmin(0)]
        on_plane[rows, columns] = False
    return Surface(depth, on_plane)


def _colour_difference(other: View, points: Float64, rgb: Float32, slack: int) -> Float64:
    """[n] mean channel difference (0 to 1) to the best pixel within `slack`; infinite where the view sees no point."""
    seen = look(other.camera, points)
    best = np.full(len(points), np.inf)
    for down in range(-slack, slack + 1):
        for right in range(-slack, slack + 1):
            row = np.clip(seen.rows + down, 0, other.camera.height - 1)
            column = np.clip(seen.columns + right, 0, other.camera.width - 1)
            difference = np.abs(other.rgb[row, column].astype(np.float32) - rgb).mean(-1) / 255
            best = np.minimum(best, difference)
    return np.where(seen.inside, best, np.inf)


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
