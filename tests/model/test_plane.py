"""Which pixels of one view can be compared with another's through a plane."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.geometry import looking_at, project, transform
from twin_node.model.plane import Plane, correlation
from twin_node.model.rays import pixel_rays
from twin_node.scene import Camera, Float64, View

WIDE = np.array([[20.0, 0, 32], [0, 20.0, 24], [0, 0, 1]])


def view_from(eye: tuple[float, float, float], target: tuple[float, float, float]) -> View:
    image = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    return View(Camera("camera", 64, 48, WIDE, looking_at(eye, target)), 0, image)


def shared(a: View, b: View, plane: Plane) -> Float64:
    """[H, W] how far inside b's image, px, a's pixels are seen through the plane; below 0 where they are not."""
    rays = pixel_rays(a.camera).reshape(-1, 3)
    centre = a.camera.T_base_cam[:3, 3]
    depth = -plane.height(centre) / (rays @ plane.normal)
    points = centre + depth[:, None] * rays
    u, v, _ = project(b.camera.K, b.camera.viewmat, points).T
    inside = np.min([u, v, b.camera.width - u, b.camera.height - v], axis=0)
    before = (depth > 0) & (transform(b.camera.viewmat, points)[:, 2] > 0)
    return np.asarray(np.where(before, inside, -1e6)).reshape(a.camera.height, a.camera.width)


@pytest.mark.parametrize("height", [-0.3, 0.4, 1.1])
def test_only_what_both_see_of_a_plane_is_compared(height: float) -> None:
    a, b = view_from((1.0, 0.2, 0.8), (0.0, 0.0, 0.3)), view_from((-0.3, 0.9, 0.7), (0.2, 0.0, 0.5))
    plane = Plane(np.array([0.0, 0.0, 1.0]), -height)
    known, inside = np.isfinite(correlation(a, b, plane)), shared(a, b, plane)
    looks_down = pixel_rays(a.camera) @ plane.normal < -1e-6  # of a plane above, what looks up is compared
    if height < 0.8:
        assert known[inside > 1.5].all() and (inside > 1.5).any()
    else:
        assert not known[looks_down].any()
    assert not known[(inside < -1.5) & looks_down].any()
