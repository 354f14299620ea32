"""Still images laid flat onto a plane, so that all cameras show it from straight above and at one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.geometry import cross, inverse_pose, transform
from twin_node.rig.calibrate.lenses import homogeneous, in_view, pixel_rays, raw_pixels
from twin_node.rig.calibrate.stills import Still
from twin_node.rig.errors import RigError
from twin_node.scene import Bool, Float32, Float64, RigCamera

LARGEST_SHEET_PX = 600
"""Longest side of a sheet: more costs time and finds little that is not already seen."""
MARGIN = 0.2
"""Share of the workspace that the ground may reach beyond it: what stands about it tells as much."""
RIM_PX = 2
"""Raw pixels next to the image's rim that are not used."""
FINEST_PX, COARSEST_PX = 1.5, 8.0
"""Blurs (1 sigma, sheet pixels) between which contrast is kept: between video noise and the light's own gradient."""
CONTRAST = 0.5
"""Log contrast beyond which a pixel counts no more: highlights shall not outvote the pattern."""


@dataclass(frozen=True)
class Ground:
    """A plane with coordinates on it."""

    plane: Float64
    """[4] unit normal and offset in m: normal . x + offset = 0."""
    origin: Float64
    """[3] m, on the plane: where sheet pixel (0, 0) lies."""
    axes: Float64
    """[2, 3] unit vectors along the sheet's columns and rows."""
    pixel_m: float
    """Side of a sheet's pixel, m."""
    width: int
    height: int

    def points(self, sheet: Float64) -> Float64:
        """Base-frame points [N, 3] m of sheet pixels [N, 2]."""
        out: Float64 = self.origin + self.pixel_m * (sheet @ self.axes)
        return out

    def pixels(self, camera: RigCamera, sheet: Float64) -> Float64:
        """Raw pixels [N, 2] at which a camera sees sheet pixels [N, 2]; far off the image for those behind it."""
        T = inverse_pose(camera.T_base_cam)
        local = sheet @ (self.pixel_m * self.axes @ T[:3, :3].T) + transform(T, self.origin)
        out = raw_pixels(camera, local)
        out[local[:, 2] <= 0] = -1e6
        return out


@dataclass(frozen=True)
class Sheet:
    """One camera's view of the ground from above."""

    contrast: Float32
    """[H, W] log contrast against the surroundings, 0 where unknown."""
    known: Bool
    """[H, W] where the camera sees something that stands still."""


def plane_hits(camera: RigCamera, plane: Float64, pixels: Float64) -> Float64:
    """Base-frame points [N, 3] m at which the rays of raw pixels [N, 2] meet a plane [4]; NaN where they do not."""
    directions = homogeneous(pixel_rays(camera, pixels)) @ camera.T_base_cam[:3, :3].T
    centre = camera.T_base_cam[:3, 3]
    slope = directions @ plane[:3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -(centre @ plane[:3] + plane[3]) / slope
    out: Float64 = centre + directions * np.where(depth > 0, depth, np.nan)[:, None]
    return out


def ground_of(cameras: Sequence[RigCamera], plane: Float64, workspace: Float64) -> Ground:
    """The part of a plane [4] in and about a workspace [2, 3] that two cameras see, at about their images' resolution.

    Raises `RigError` where no two see a common part.
    """
    hits = [plane_hits(camera, plane, _pixel_grid(camera)) for camera in cameras]
    margin = MARGIN * np.ptp(workspace, axis=0)
    near = [((points > workspace[0] - margin) & (points < workspace[1] + margin)).all(1) for points in hits]
    footprints = [_footprint(camera, plane, near[i]) for i, camera in enumerate(cameras)]
    shared = [hits[i][near[i] & _seen_elsewhere(hits[i], cameras, i)] for i in range(len(cameras))]
    points = np.concatenate(shared)
    if len(points) < 9:
        names = ", ".join(camera.name for camera in cameras)
        raise RigError(f"cameras {names}: expected a plane that two of them see, found none; give --plane none")
    first = np.cross([0.0, 1.0, 0.0], plane[:3]) if abs(plane[1]) < 0.9 else np.cross(plane[:3], [1.0, 0.0, 0.0])
    axes = np.stack([first, np.cross(plane[:3], first)]) / np.linalg.norm(first)
    low, high = np.percentile(points @ axes.T, [1, 99], axis=0)
    pixel_m = max(float(np.nanmedian(footprints)), float((high - low).max()) / LARGEST_SHEET_PX)
    width, height = (int(v) for v in np.ceil((high - low) / pixel_m))
    origin = low @ axes - plane[:3] * plane[3]
    return Ground(plane, origin, axes, pixel_m, width, height)


def lay_flat(still: Still, ground: Ground) -> Sheet:
    """What a still image shows of the ground."""
    u, v = np.meshgrid(np.arange(ground.width, dtype=np.float64), np.arange(ground.height, dtype=np.float64))
    raw = ground.pixels(still.camera, np.stack([u.ravel(), v.ravel()], -1)).reshape(ground.height, ground.width, 2)
    xy = np.clip(raw, -1e4, 1e4).astype(np.float32)
    grey = np.log(cv2.cvtColor(still.rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) + 8)
    flat = np.asarray(cv2.remap(grey, xy[..., 0], xy[..., 1], cv2.INTER_LINEAR), np.float32)
    still_there = cv2.remap(still.still.astype(np.float32), xy[..., 0], xy[..., 1], cv2.INTER_LINEAR) > 0.99
    limit = np.array([still.camera.width, still.camera.height]) - 1 - RIM_PX
    known = still_there & ((raw >= RIM_PX) & (raw <= limit)).all(-1)
    weight = known.astype(np.float32)
    contrast: Float32 = (_blurred(flat, weight, FINEST_PX) - _blurred(flat, weight, COARSEST_PX)) * weight
    return Sheet(np.clip(contrast, -CONTRAST, CONTRAST).astype(np.float32), known)


def _blurred(image: Float32, weight: Float32, sigma: float) -> Float32:
    total = cv2.GaussianBlur(image * weight, (0, 0), sigma)
    out: Float32 = (total / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3)).astype(np.float32)
    return out


def _pixel_grid(camera: RigCamera) -> Float64:
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 33), np.linspace(0, camera.height - 1, 25))
    return np.stack([u.ravel(), v.ravel()], -1)


def _footprint(camera: RigCamera, plane: Float64, near: Bool) -> float:
    """Median side in m of what a pixel covers on the plane, over the pixel grid where it is near; NaN for none."""
    grid = _pixel_grid(camera)
    right, down = (plane_hits(camera, plane, grid + step) for step in ([1.0, 0.0], [0.0, 1.0]))
    here = plane_hits(camera, plane, grid)
    area = np.linalg.norm(cross(right - here, down - here), axis=1)
    return float(np.sqrt(np.median(area[near]))) if near.any() else float("nan")


def _seen_elsewhere(points: Float64, cameras: Sequence[RigCamera], own: int) -> Bool:
    """Which points [N, 3] another camera than `own` sees; False for NaN."""
    seen = np.zeros(len(points), dtype=bool)
    there = np.isfinite(points).all(1)
    for i, camera in enumerate(cameras):
        if i != own and there.any():
            local = transform(inverse_pose(camera.T_base_cam), points[there])
            seen[np.flatnonzero(there)[in_view(camera, local)]] = True
    return seen
