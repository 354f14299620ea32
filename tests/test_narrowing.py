"""Narrowed sets: the same scene from the same place, in fewer pixels."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from twin_node.geometry import project
from twin_node.scene import Camera, Float64, FrameSet, View
from twin_node.scene.narrowing import Narrower, narrowed_to, widened_to

K = np.array([[40.0, 0.0, 24.0], [0.0, 40.0, 18.0], [0.0, 0.0, 1.0]])
POINT = np.array([[0.1, -0.05, 1.0]])
"""In front of the camera, m."""


def seen(camera: Camera) -> Float64:
    """Where a camera sees `POINT`, px."""
    return np.asarray(project(camera.K, camera.viewmat, POINT))


def view() -> View:
    """48 x 36 pixels that get brighter to the right, of which the left half was found and the right has depth."""
    rgb = np.broadcast_to(np.arange(48, dtype=np.uint8)[None, :, None] * 5, (36, 48, 3))
    depth = np.zeros((36, 48), np.float32)
    depth[:, 24:] = 1.5
    return View(Camera("front", 48, 36, K, np.eye(4)), 7, rgb, depth, depth == 0)


def test_a_narrowed_view_shows_the_same_from_the_same_place() -> None:
    wide = view()
    half = Narrower(24).view(wide)
    assert half.rgb.shape == (18, 24, 3) and half.depth is not None and half.valid is not None
    np.testing.assert_allclose(half.camera.K[:2], K[:2] / 2)
    np.testing.assert_allclose(half.rgb.mean((0, 1)), wide.rgb.mean((0, 1)), atol=1)
    np.testing.assert_array_equal(np.unique(half.depth), [0.0, 1.5])
    assert half.depth[0, 12] == 1.5 and half.valid[0, 11] and not half.valid[0, 12]
    np.testing.assert_allclose(seen(half.camera)[:, :2], seen(wide.camera)[:, :2] / 2)


@pytest.mark.parametrize("width", [16, 20])
def test_depth_is_of_the_pixel_in_the_middle_and_valid_of_all(width: int) -> None:
    wide, scale = view(), 48 / width
    centres = np.broadcast_to(np.arange(48, dtype=np.float32) + 0.5, (36, 48))
    found = centres < 27
    narrow = Narrower(width).view(dataclasses.replace(wide, depth=centres.copy(), valid=found))
    wanted = (np.arange(width) + 0.5) * scale
    assert narrow.depth is not None and narrow.valid is not None
    assert np.abs(narrow.depth - wanted).max() <= 0.5
    np.testing.assert_array_equal(narrow.valid[0], wanted + scale / 2 <= 27)


def test_views_that_are_no_wider_stay_as_they_are() -> None:
    wide = view()
    assert Narrower(48).view(wide) is wide


def test_a_cameras_views_keep_one_camera_until_it_is_another() -> None:
    wide, narrower = view(), Narrower(24)
    frames = FrameSet(7, (wide,), None, 0)
    first, again = narrower.narrowed(frames), narrower.narrowed(frames)
    assert first.views[0].camera is again.views[0].camera
    moved = dataclasses.replace(wide, camera=dataclasses.replace(wide.camera, T_base_cam=2 * np.eye(4)))
    assert narrower.view(moved).camera.T_base_cam[0, 0] == 2


def test_a_mask_of_one_pixel_is_in_the_narrow_pixel_that_holds_it() -> None:
    wide = view().camera
    narrow = Narrower(12).view(view()).camera
    mask = np.zeros((wide.height, wide.width), np.bool_)
    mask[13, 30] = True
    held = narrowed_to(narrow, mask)
    assert np.argwhere(held).tolist() == [[3, 7]]
    back = np.argwhere(widened_to(wide, held))
    assert (back.min(0).tolist(), back.max(0).tolist()) == ([12, 28], [15, 31])
