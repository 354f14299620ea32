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
REPROJECTION_PX = 2.0
"""Largest reprojection error of a triangulated point, plus what the calibration's own error explains."""


def triangulate(views: Sequence[View]) -> Float64:
    """Base-frame points [n, 3] m that pairs of views show alike; n may be 0 where the baselines are too wide."""
    sift = cv2.SIFT.create(contrastThreshold=0.01)
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
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {match.queryIdx: match.trainIdx for match in matcher.match(des_b, des_a)}
    kept = [
        (best.queryIdx, best.trainIdx)
        for best, second in matcher.knnMatch(des_a, des_b, k=2)
        if best.distance < RATIO * second.distance and back.get(best.trainIdx) == best.queryIdx
    ]
    return np.array([[at_a[i], at_b[j]] for i, j in kept]).reshape(-1, 2, 2)


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
