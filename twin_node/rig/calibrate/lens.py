"""The lens both ways: raw pixels to rays, and points before a camera to raw pixels."""

from __future__ import annotations

import cv2
import numpy as np

from twin_node.rig.undistort import distort
from twin_node.scene import Float64, RigCamera

BEHIND_M = 1e-3
"""Least depth that is projected: what lies behind it is moved there, far off the image, so that solvers stay finite."""


def pixel_rays(camera: RigCamera, pixels: Float64) -> Float64:
    """Rays (x/z, y/z) [N, 2] in the optical frame of raw pixels [N, 2] (OpenCV convention); undoes `distort`."""
    if not len(pixels):  # OpenCV gives nothing of the shape asked for
        return np.zeros((0, 2))
    shaped = np.ascontiguousarray(pixels, dtype=np.float64)[:, None]
    if camera.distortion_model == "equidistant":
        rays = cv2.fisheye.undistortPoints(shaped, camera.K, camera.D)
    else:
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
        rays = cv2.undistortPointsIter(shaped, camera.K, camera.D, np.eye(3), np.eye(3), criteria)
    out: Float64 = np.asarray(rays, dtype=np.float64).reshape(-1, 2)
    return out


def raw_pixels(camera: RigCamera, points: Float64) -> Float64:
    """Raw pixels [N, 2] (OpenCV convention) of points [N, 3] m in the optical frame."""
    if not len(points):
        return np.zeros((0, 2))
    return distort(camera, points[:, :2] / np.maximum(points[:, 2:], BEHIND_M))
