"""Planes that the views agree on: the table or floor that most of a cell's pixels show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import inverse_pose
from twin_node.model.rays import pixel_rays
from twin_node.scene import Camera, Float32, Float64, View

PATCH_PX = 7
"""Side of the window over which images are compared: about twice the footprint of a hole or marking at 160 px width."""
TEXTURE = 2.0 / 255
"""Standard deviation (0 to 1) inside a window below which its correlation says nothing: the noise of 8-bit video."""
SHARES = (np.arange(256) / 255).astype(np.float32)
"""[256] of full brightness, per 8-bit level."""
MEASURED_SHARE = 0.15
"""Share of the measured points that a dominant plane holds at least."""
MIN_AGREEMENT, DISTINCT = 0.01, 2.0
"""A plane is believed if it scores this much, and this many times what three quarters of the heights do not reach."""


@dataclass(frozen=True)
class Plane:
    """Points x of `base_link` with normal . x + offset = 0; the normal points to the cameras' side."""

    normal: Float64
    """[3] of length one."""
    offset: float
    """m."""

    def depth(self, camera: Camera) -> Float64:
        """[H, W] depth along the optical axis in m at which each pixel meets the plane; infinite where it does not."""
        height = self.normal @ camera.T_base_cam[:3, 3] + self.offset
        slope = pixel_rays(camera) @ self.normal
        with np.errstate(divide="ignore"):
            depth: Float64 = np.where(slope < -1e-6, -height / np.minimum(slope, -1e-6), np.inf)
        return depth

    def height(self, points: NDArray[np.floating]) -> Float64:
        """[...] m above the plane of points [..., 3]."""
        above: Float64 = points @ self.normal + self.offset
        return above

    def shifted(self, height: float) -> Plane:
        """The parallel plane `height` m above."""
        return Plane(self.normal, self.offset - height)


def correlation(a: View, b: View, plane: Plane) -> Float32:
    """[H, W] local normalised correlation of a's image with b's seen through `plane`; NaN where not shared."""
    return _correlation(_Shades.of(a), _Shades.of(b), plane)


@dataclass(frozen=True)
class _Shades:
    """A view's brightness, as it is compared with others."""

    camera: Camera
    gray: Float32
    """[H, W] 0 to 1."""
    mean: Float32
    """[H, W] over the window about each pixel."""
    variance: Float32
    """[H, W] over it, and that of the noise."""

    @classmethod
    def of(cls, view: View) -> _Shades:
        """Of a view."""
        gray = np.asarray(cv2.LUT(cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY), SHARES), np.float32)
        return cls(view.camera, gray, *_moments(gray))


def _correlation(a: _Shades, b: _Shades, plane: Plane) -> Float32:
    T = inverse_pose(b.camera.T_base_cam) @ a.camera.T_base_cam
    normal = a.camera.T_base_cam[:3, :3].T @ plane.normal
    offset = plane.normal @ a.camera.T_base_cam[:3, 3] + plane.offset
    if abs(offset) < 1e-6:
        return np.full(a.gray.shape, np.nan, np.float32)
    H = _corner_K(b.camera) @ (T[:3, :3] - np.outer(T[:3, 3], normal) / offset) @ np.linalg.inv(_corner_K(a.camera))
    size = (a.camera.width, a.camera.height)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = np.asarray(
        cv2.warpPerspective(b.gray, H, size, flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0), np.float32
    )
    mean, variance = _moments(warped)
    out: Float32 = (_window_mean(a.gray * warped) - a.mean * mean) / np.sqrt(a.variance * variance)
    out[warped < 0] = np.nan
    if offset < 0:  # the camera is below: what looks against the normal meets the plane behind it
        out[pixel_rays(a.camera) @ plane.normal < -1e-6] = np.nan
    corners = np.array([[0, 0, 1], [size[0] - 1, 0, 1], [0, size[1] - 1, 1], [size[0] - 1, size[1] - 1, 1]])
    if (corners @ H[2]).min() <= 0:  # else all of a linear function is above 0
        u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
        out[H[2, 0] * u + H[2, 1] * v + H[2, 2] <= 0] = np.nan
    return out


def _moments(gray: Float32) -> tuple[Float32, Float32]:
    """[H, W] mean over the window about each pixel, and the variance there with that of the noise."""
    mean = _window_mean(gray)
    return mean, np.maximum(_window_mean(gray * gray) - mean**2, 0) + np.float32(TEXTURE**2)


def _window_mean(image: Float32) -> Float32:
    return np.asarray(cv2.boxFilter(image, -1, (PATCH_PX, PATCH_PX), borderType=cv2.BORDER_REFLECT), np.float32)


def dominant_plane(views: Sequence[View], points: Float64) -> Plane | None:
    """The plane that explains most of the views, or None where nothing agrees.

    Candidates are planes through triangulated `points` [n, 3] (RANSAC) and horizontal planes below the cameras; the one
    under which the images agree best is refined in tilt and offset.
    """
    centres = np.stack([view.camera.T_base_cam[:3, 3] for view in views])
    lowest = centres[:, 2].min()
    span = max(np.ptp(centres, axis=0).max(), 0.2)
    candidates = [
        Plane(np.array([0.0, 0.0, 1.0]), -z) for z in np.linspace(lowest - 2 * span, lowest - 0.05 * span, 96)
    ]
    levels = len(candidates)
    candidates += _ransac(points, centres)
    if len(views) < 2:
        return None
    shades = [_Shades.of(view) for view in views]
    scores = [_agreement(shades, plane) for plane in candidates]
    best = int(np.argmax(scores))
    if scores[best] < max(MIN_AGREEMENT, DISTINCT * float(np.percentile(scores[:levels], 75))):
        return None
    return _refined(shades, candidates[best], scores[best], span)


def plane_through(points: Float64, centres: Float64) -> Plane | None:
    """The plane that holds the most of measured `points` [n, 3], seen from cameras at `centres` [C, 3].

    None where the best of them holds less than `MEASURED_SHARE`.
    """
    found = _ransac(points, centres)
    if not found:
        return None
    inside = np.abs(found[0].height(points)) < _tolerance(points, centres)
    if inside.mean() < MEASURED_SHARE:
        return None
    centre = points[inside].mean(0)
    normal = np.linalg.svd(points[inside] - centre, full_matrices=False)[2][2]
    normal = normal if normal @ found[0].normal > 0 else -normal
    return Plane(normal, float(-normal @ centre))


def _agreement(views: Sequence[_Shades], plane: Plane) -> float:
    """Mean correlation over the pixels that pairs of views share through the plane, discounted where they share few."""
    total = 0.0
    for a, b in permutations(views, 2):
        found = _correlation(a, b, plane)
        shared = np.isfinite(found)
        total += float(found[shared].sum()) / found.size
    return total / (len(views) * (len(views) - 1))


def _refined(views: Sequence[_Shades], plane: Plane, score: float, span: float) -> Plane:
    """Coordinate ascent over tilt (rad) and offset (m), the step halved whenever it no longer helps."""
    step = span / 32
    first = np.cross(plane.normal, [1.0, 0.0, 0.0] if abs(plane.normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    axes = np.stack([first, np.cross(plane.normal, first)]) / np.linalg.norm(first)
    anchor = np.mean([view.camera.T_base_cam[:3, 3] + _optical_hit(view.camera, plane) for view in views], axis=0)
    for _ in range(5):
        for move in np.concatenate([np.eye(3), -np.eye(3)]) * step:
            normal = plane.normal + (move[:2] / span) @ axes
            normal /= np.linalg.norm(normal)
            offset = -normal @ (anchor - plane.normal * plane.height(anchor)) - move[2]
            candidate = Plane(normal, float(offset))
            found = _agreement(views, candidate)
            if found > score:
                plane, score = candidate, found
        step /= 2
    return plane


def _optical_hit(camera: Camera, plane: Plane) -> Float64:
    """From the camera's centre to where its optical axis meets the plane, m; one metre ahead where it does not."""
    axis = camera.T_base_cam[:3, 2]
    slope = axis @ plane.normal
    depth = -plane.height(camera.T_base_cam[:3, 3]) / slope if slope < -0.05 else 1.0
    hit: Float64 = axis * depth
    return hit


_TRIALS = 200
"""Triples of points that planes are laid through."""
_KEPT = 8
"""Planes that are compared in the images."""


def _ransac(points: Float64, centres: Float64) -> list[Plane]:
    """The best-supported planes through triples of points, normals towards the cameras."""
    if len(points) < 8:
        return []
    rng = np.random.default_rng(0)
    tolerance = _tolerance(points, centres)
    supported: list[tuple[int, Plane]] = []
    for _ in range(_TRIALS):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-9:
            continue
        normal /= length
        normal = normal if normal @ (centres.mean(0) - a) > 0 else -normal
        plane = Plane(normal, float(-normal @ a))
        supported.append((int((np.abs(plane.height(points)) < tolerance).sum()), plane))
    supported.sort(key=lambda pair: -pair[0])
    return [plane for _, plane in supported[:_KEPT]]


def _tolerance(points: Float64, centres: Float64) -> float:
    """Distance in m from a plane that still counts as on it: 1 % of the viewing distance, what depth cameras reach."""
    return 0.01 * float(np.median(np.linalg.norm(points - centres.mean(0), axis=1)))


def _corner_K(camera: Camera) -> Float64:
    """Intrinsics in OpenCV's convention (centre of the top-left pixel at 0, 0)."""
    K = camera.K.copy()
    K[:2, 2] -= 0.5
    return K
