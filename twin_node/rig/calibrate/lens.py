"""The lens of a rig's camera both ways: raw pixels to rays, and points before the camera to raw pixels."""

from __future__ import annotations

import numpy as np

from twin_node.rig.calibrate.lenses import BEHIND_M, lens_of, rays_of
from twin_node.rig.undistort import distort
from twin_node.scene import Float64, RigCamera


def pixel_rays(camera: RigCamera, pixels: Float64) -> Float64:
    """Rays (x/z, y/z) [N, 2] in the optical frame of raw pixels [N, 2] (OpenCV convention); undoes `distort`."""
    return rays_of(lens_of(camera), pixels)


def raw_pixels(camera: RigCamera, points: Float64) -> Float64:
    """Raw pixels [N, 2] (OpenCV convention) of points [N, 3] m in the optical frame; far off the image behind it."""
    if not len(points):
        return np.zeros((0, 2))
    return distort(camera, points[:, :2] / np.maximum(points[:, 2:], BEHIND_M))
