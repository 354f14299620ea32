"""Which pixels the arm hides: its capsules, grown by a margin, as a camera sees them."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.robot.kinematics import forward_kinematics, place_capsules
from twin_node.robot.model import ArmModel
from twin_node.scene import Bool, Camera, Float64, UInt8

_RIM_POINTS = 16
"""Corners of the polygon drawn around each end's outline; it stands out by less than 2 % of the radius."""
_TURN = np.linspace(0, 2 * np.pi, _RIM_POINTS, endpoint=False)[:, None]
_COS, _SIN = np.cos(_TURN), np.sin(_TURN)
_SIGMAS = 2.0
"""How many standard errors of the camera's pose the arm is grown by (95 % of errors in one direction)."""
_PIXEL_MARGIN = 0.5
"""Pixels added around a polygon, because OpenCV fills to the nearest pixel and rounds corners."""
_WIDEST = 0.999
"""Sine of the largest half angle of an end's cone of rays: a camera that nearly touches an end sees it up to here."""
_SUBPIXEL_BITS = 4
"""Fractional bits of corners given to OpenCV, 1/16 pixel."""
_FAR_PIXEL = 2.0**24
"""Corners are kept within this many pixels, so that they fit OpenCV's fixed-point numbers."""


class Outline(NamedTuple):
    """The grown arm before one camera."""

    mask: Bool
    """[H, W] where it may be seen."""
    ends: Float64
    """[C, 2, 3] m of the axes of its capsules, in the optical frame."""
    radii: Float64
    """[C] m."""


def robot_outline(model: ArmModel, q: NDArray[np.floating], camera: Camera, margin_m: float = 0.03) -> Outline:
    """Where the arm, at joint angles [J] (rad), may be seen by the camera.

    Every capsule is grown by `margin_m` plus twice the camera's calibration error `sigma_m`. Its outline is the convex
    hull of those of its two end spheres; every pixel whose centre is inside counts. Raises `RobotError` for joint
    angles that are not usable.
    """
    placed = place_capsules(model, forward_kinematics(model, q))
    ends = placed.ends @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    radii = placed.radii + margin_m + _SIGMAS * camera.sigma_m
    in_front = ends[..., 2].min(1) > radii * 1.01
    behind = ends[..., 2].max(1) <= -radii
    mask = np.zeros((camera.height, camera.width), np.uint8)
    if in_front.any():
        pixel = ends[in_front, :, 2] / min(camera.K[0, 0], camera.K[1, 1])
        _draw_outlines(mask, _rims(ends[in_front], radii[in_front, None] + _PIXEL_MARGIN * pixel), camera.K)
    around = np.flatnonzero(~in_front & ~behind)
    if len(around):
        rays = _pixel_rays(camera)
        for index in around:
            mask |= (_ray_segment_distance(rays, ends[index]) <= radii[index]).astype(np.uint8)
    return Outline(mask.astype(np.bool_), ends, radii)


def robot_mask(model: ArmModel, q: NDArray[np.floating], camera: Camera, margin_m: float = 0.03) -> Bool:
    """The mask [H, W] of `robot_outline`."""
    return robot_outline(model, q, camera, margin_m).mask


def _rims(ends: Float64, radii: Float64) -> Float64:
    """Points [C, 2 * _RIM_POINTS, 3] around the circles in which rays touch the end spheres [C, 2, 3], radii [C, 2]."""
    distance = np.linalg.norm(ends, axis=-1)
    ratio = np.minimum(radii / distance, _WIDEST)
    center = ends * (1 - ratio**2)[..., None]
    circumscribed = ratio * distance * np.sqrt(1 - ratio**2) / np.cos(np.pi / _RIM_POINTS)
    axis = ends / distance[..., None]
    x, y, z = np.moveaxis(axis, -1, 0)
    length = np.sqrt(z * z + y * y)  # z is positive, so the axis is never x itself
    up, down = z / length, -y / length  # of the unit vector across axis and x
    across = np.stack([np.zeros_like(x), up, down], -1)
    other = np.stack([y * down - z * up, -x * down, x * up], -1)
    rim = across[..., None, :] * _COS + other[..., None, :] * _SIN
    points: Float64 = center[..., None, :] + circumscribed[..., None, None] * rim
    return points.reshape(len(ends), -1, 3)


def _draw_outlines(mask: UInt8, rims: Float64, K: Float64) -> None:
    """Fills the hull of each capsule's rim points; half a pixel turns corner-based coordinates into OpenCV's."""
    depth = np.maximum(rims[..., 2], 1e-6)
    pixels = rims[..., :2] / depth[..., None] * [K[0, 0], K[1, 1]] + [K[0, 2], K[1, 2]] - 0.5
    corners = np.clip(pixels, -_FAR_PIXEL, _FAR_PIXEL).astype(np.float32)
    for outline in corners:
        hull = cv2.convexHull(outline)
        fixed = np.rint(hull.astype(np.float64) * 2**_SUBPIXEL_BITS).astype(np.int32)
        cv2.fillConvexPoly(mask, fixed, 1, cv2.LINE_8, _SUBPIXEL_BITS)


def _pixel_rays(camera: Camera) -> Float64:
    """Unit vectors [H, W, 3] along which the pixels' centres look."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    K = camera.K
    rays = np.stack([(columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1], np.ones_like(columns)], axis=-1)
    return np.asarray(rays / np.sqrt(np.einsum("hwc,hwc->hw", rays, rays))[..., None])


def _ray_segment_distance(rays: Float64, ends: Float64) -> Float64:
    """Distances [...] in metres between rays from the origin along unit vectors [..., 3] and a segment [2, 3]."""
    axis = ends[1] - ends[0]
    along, length_sq, first = rays @ axis, float(axis @ axis), rays @ ends[0]
    determinant = length_sq - along**2
    parallel = determinant < 1e-12
    t = np.where(parallel, 0.0, (first * along - ends[0] @ axis) / np.where(parallel, 1.0, determinant))
    nearest_sq = np.full(rays.shape[:-1], np.inf)
    for candidate in (np.clip(t, 0, 1), _foot_of_origin(ends)):
        from_origin_sq = float(ends[0] @ ends[0]) + candidate * (2 * float(ends[0] @ axis) + candidate * length_sq)
        reach = np.maximum(first + candidate * along, 0.0)
        nearest_sq = np.minimum(nearest_sq, from_origin_sq - reach * reach)
    return np.asarray(np.sqrt(np.maximum(nearest_sq, 0.0)))


def _foot_of_origin(ends: Float64) -> float:
    """Where [0, 1] along a segment [2, 3] it comes closest to the origin."""
    axis = ends[1] - ends[0]
    return float(np.clip(-(ends[0] @ axis) / max(float(axis @ axis), 1e-18), 0.0, 1.0))
