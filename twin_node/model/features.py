"""Points that two views agree on: SIFT matches held to the epipolar geometry of the calibrated rig and triangulated."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import project
from twin_node.scene import Camera, Float64, View

UPSCALE = 2
"""SIFT finds little below its first octave; working images are small, so they are enlarged."""
RATIO = 0.8
"""Best to second-best descriptor distance of a match worth keeping (Lowe, 2004, section 7.1)."""
BLOCK = 1024
"""Descriptors that are compared with all of another view's at a time: 4 kB each per thousand."""
REPROJECTION_PX = 2.0
"""Largest reprojection error of a triangulated point, plus what the calibration's own error explains."""


def triangulate(views: Sequence[View]) -> Float64:
    """Base-frame points [n, 3] m that pairs of views show alike; n may be 0 where the baselines are too wide."""
    sift = cv2.SIFT.create(contrastThreshold=0.01, enable_precise_upscale=True)
    found = [_describe(sift, view) for view in views]
    clouds = [np.zeros((0, 3))]
    for a, b in combinations(range(len(views)), 2):
        pixels = _matches(*found[a], *found[b])
        clouds.append(_triangulate_pair(views[a].camera, views[b].camera, pixels[:, 0], pixels[:, 1]))
    return np.concatenate(clouds)


def _describe(sift: cv2.SIFT, view: View) -> tuple[Float64, NDArray[np.float32]]:
    gray = cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY)
    large = cv2.resize(gray, None, fx=UPSCALE, fy=UPSCALE, interpolation=cv2.INTER_CUBIC)
    points, descriptors = sift.detectAndCompute(large, None)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    return (np.array([point.pt for point in points]) + 0.5) / UPSCALE, descriptors.astype(np.float32)


def _matches(at_a: Float64, des_a: NDArray[np.float32], at_b: Float64, des_b: NDArray[np.float32]) -> Float64:
    """Mutual best matches as pixels [n, 2, 2]: (view a or b, (u, v))."""
    if len(des_a) < 2 or len(des_b) < 2:
        return np.zeros((0, 2, 2))
    best, is_distinct = np.empty(len(des_a), np.int64), np.empty(len(des_a), np.bool_)
    nearest, back = np.full(len(des_b), np.inf, np.float32), np.zeros(len(des_b), np.int64)
    for start in range(0, len(des_a), BLOCK):
        block = slice(start, start + BLOCK)
        squared = _squared_distances(des_a[block], des_b)
        best[block] = squared.argmin(1)
        first, second = np.sqrt(np.partition(squared, 1, axis=1)[:, :2].astype(np.float64)).T
        is_distinct[block] = first < RATIO * second
        nearer = squared.min(0) < nearest
        back[nearer] = start + squared.argmin(0)[nearer]
        nearest = np.minimum(nearest, squared.min(0))
    kept = np.nonzero(is_distinct & (back[best] == np.arange(len(des_a))))[0]
    return np.stack([at_a[kept], at_b[best[kept]]], axis=1)


def _squared_distances(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """[n, m]; exact, for SIFT's descriptors are whole numbers whose squares add up to less than 2^24."""
    found: NDArray[np.float32] = (a * a).sum(1)[:, None] + (b * b).sum(1) - 2 * (a @ b.T)
    return found


def _triangulate_pair(a: Camera, b: Camera, at_a: Float64, at_b: Float64) -> Float64:
    if not len(at_a):
        return np.zeros((0, 3))
    homogeneous = cv2.triangulatePoints(a.K @ a.viewmat[:3], b.K @ b.viewmat[:3], at_a.T, at_b.T)
    weight = np.where(np.abs(homogeneous[3]) < 1e-9, 1e-9, homogeneous[3])
    points = (homogeneous[:3] / weight).T
    good = np.ones(len(points), dtype=bool)
    for camera, pixels in ((a, at_a), (b, at_b)):
        uvz = project(camera.K, camera.viewmat, points)
        allowed = REPROJECTION_PX + camera.K[0, 0] * camera.sigma_m / np.maximum(uvz[:, 2], 0.1)
        good &= (uvz[:, 2] > 0.05) & (np.linalg.norm(uvz[:, :2] - pixels, axis=1) < allowed)
    return points[good]
