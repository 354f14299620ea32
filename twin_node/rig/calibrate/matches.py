"""Points that two cameras see alike, as raw pixels, and how far a calibration is from explaining them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import inverse_pose, transform
from twin_node.rig.calibrate.birds_eye import plane_hits
from twin_node.rig.calibrate.lenses import homogeneous, pixel_rays, raw_pixels
from twin_node.rig.calibrate.rotations import cross_matrix
from twin_node.rig.calibrate.stills import Still
from twin_node.scene import Bool, Float64, RigCamera

RATIO = 0.8
"""Best to second-best descriptor distance of a match worth keeping (Lowe, 2004, section 7.1)."""
MOST_FEATURES = 2000
"""Features per camera, the strongest: matching time grows with the square."""
LARGEST_PX = 960
"""Longest side of the image that features are sought in."""
SMALLEST_PX = 640
"""Images with a shorter longest side are enlarged: SIFT finds little below its first octave."""

NOWHERE_M = 1e3
"""Each coordinate of where rays that meet no plane are taken to meet it: far off every image."""


@dataclass(frozen=True)
class Matches:
    """The same points of the scene in two cameras of a rig."""

    a: int
    """Index of the first camera."""
    b: int
    pixels_a: Float64
    """[n, 2] raw pixels, OpenCV convention."""
    pixels_b: Float64
    """[n, 2]."""
    on_plane: bool
    """Whether the points lie on the common plane."""

    def where(self, rows: Bool) -> Matches:
        """The matches under a mask [n]."""
        return Matches(self.a, self.b, self.pixels_a[rows], self.pixels_b[rows], self.on_plane)

    def __len__(self) -> int:
        return len(self.pixels_a)


def feature_matches(stills: Sequence[Still]) -> list[Matches]:
    """Mutual best SIFT matches of what stands still, of every pair of cameras; not yet held to any geometry."""
    features = [_described(still) for still in stills]
    return [_matched(features, a, b) for a, b in combinations(range(len(stills)), 2)]


def _matched(features: Sequence[_Features], a: int, b: int) -> Matches:
    at_a, des_a = features[a].pixels, features[a].descriptors
    at_b, des_b = features[b].pixels, features[b].descriptors
    empty = np.zeros((0, 2))
    if min(len(at_a), len(at_b)) < 2:
        return Matches(a, b, empty, empty, on_plane=False)
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {match.queryIdx: match.trainIdx for match in matcher.match(des_b, des_a)}
    pairs = [
        (best.queryIdx, best.trainIdx)
        for best, second in matcher.knnMatch(des_a, des_b, k=2)
        if best.distance < RATIO * second.distance and back.get(best.trainIdx) == best.queryIdx
    ]
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return Matches(a, b, at_a[rows[:, 0]], at_b[rows[:, 1]], on_plane=False)


def epipolar_px(a: RigCamera, b: RigCamera, pixels_a: Float64, pixels_b: Float64) -> Float64:
    """[n] signed distance of matches from their epipolar lines, undistorted pixels (root of Sampson's error).

    Hartley and Zisserman, Multiple View Geometry, section 11.4.3.
    """
    T = inverse_pose(b.T_base_cam) @ a.T_base_cam
    t = T[:3, 3] / max(float(np.linalg.norm(T[:3, 3])), 1e-9)
    E = cross_matrix(t) @ T[:3, :3]
    in_a, in_b = homogeneous(pixel_rays(a, pixels_a)), homogeneous(pixel_rays(b, pixels_b))
    lines_b, lines_a = in_a @ E.T, in_b @ E
    gradient = (lines_a[:, :2] ** 2).sum(1) + (lines_b[:, :2] ** 2).sum(1)
    focal = np.sqrt(a.K[0, 0] * b.K[0, 0])
    # The root of Sampson's error is shared by both images; each is off by the square root of two times less.
    out: Float64 = focal * np.sqrt(2) * (in_b * lines_b).sum(1) / np.sqrt(np.maximum(gradient, 1e-18))
    return out


def transfer_px(a: RigCamera, b: RigCamera, plane: Float64, pixels_a: Float64, pixels_b: Float64) -> Float64:
    """[n, 2] raw pixels of b from where a point is seen to where its pixel in a says that it is on a plane [4]."""
    points = np.nan_to_num(plane_hits(a, plane, pixels_a), nan=NOWHERE_M)
    out: Float64 = raw_pixels(b, transform(inverse_pose(b.T_base_cam), points)) - pixels_b
    return out


def plane_gap_m(a: RigCamera, b: RigCamera, plane: Float64, pixels_a: Float64, pixels_b: Float64) -> Float64:
    """[n] metres on a plane [4] between where both cameras put a point of it."""
    gap: Float64 = np.linalg.norm(plane_hits(a, plane, pixels_a) - plane_hits(b, plane, pixels_b), axis=1)
    return gap


@dataclass(frozen=True)
class _Features:
    pixels: Float64
    descriptors: NDArray[np.float32]


def _described(still: Still) -> _Features:
    grey = cv2.cvtColor(still.rgb, cv2.COLOR_RGB2GRAY)
    longest = max(grey.shape)
    scale = SMALLEST_PX / longest if longest < SMALLEST_PX else min(1.0, LARGEST_PX / longest)
    method = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    resized = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=method)
    mask = cv2.resize(still.still.astype(np.uint8) * 255, resized.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    sift = cv2.SIFT.create(nfeatures=MOST_FEATURES, contrastThreshold=0.01, enable_precise_upscale=True)
    points, descriptors = sift.detectAndCompute(resized, mask)
    if descriptors is None:
        return _Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    pixels = (np.array([point.pt for point in points], dtype=np.float64) + 0.5) / scale - 0.5
    return _Features(pixels, descriptors.astype(np.float32))
