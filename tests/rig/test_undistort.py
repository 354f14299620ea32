"""Undistortion against the camera models' own projection, in every model and at every scale."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.geometry import project
from twin_node.rig import RigError, Undistorter
from twin_node.rig.undistort import distort
from twin_node.scene import Camera, Float64, RigCamera, UInt8

PINHOLE = RigCamera("cam", 480, 270, np.array([[250.0, 0, 236], [0, 255, 138], [0, 0, 1]]), np.eye(4))
LENSES = {
    "none": PINHOLE,
    "plumb_bob": replace(PINHOLE, D=np.array([-0.2, 0.06, 0.001, -0.002, 0.0])),
    "plumb_bob of four": replace(PINHOLE, D=np.array([-0.2, 0.06, 0.001, -0.002])),
    "rational_polynomial": replace(
        PINHOLE, distortion_model="rational_polynomial", D=np.array([0.3, 0.1, 0.001, 0.001, 0.01, 0.5, 0.1, 0.02])
    ),
    "equidistant": replace(PINHOLE, distortion_model="equidistant", D=np.array([-0.03, 0.01, 0.0, 0.0])),
    "equidistant of zeros": replace(PINHOLE, distortion_model="equidistant", D=np.zeros(4)),
}
RNG = np.random.default_rng(0)


def points_in_view(camera: Camera, margin: float) -> Float64:
    """Points [12, 3] of the optical frame, 1 to 2 m away, that fall inside the image by a margin in pixels."""
    u = RNG.uniform(margin, camera.width - margin, 12)
    v = RNG.uniform(margin, camera.height - margin, 12)
    z = RNG.uniform(1, 2, 12)
    K = camera.K
    return np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=1)


def raw_pixels(camera: RigCamera, points: Float64) -> Float64:
    """Where OpenCV's own model puts points in the raw image."""
    rays, zero = points[:, None], np.zeros(3)
    model = cv2.fisheye.projectPoints if camera.distortion_model == "equidistant" else cv2.projectPoints
    return np.asarray(model(rays, zero, zero, camera.K, camera.D)[0]).reshape(-1, 2)


def spot(camera: RigCamera, pixel: Float64, sigma: float = 2.5) -> UInt8:
    """A raw image with one bright Gaussian spot."""
    v, u = np.mgrid[: camera.height, : camera.width]
    bright = 255 * np.exp(-((u - pixel[0]) ** 2 + (v - pixel[1]) ** 2) / (2 * sigma**2))
    return np.repeat(bright.astype(np.uint8)[..., None], 3, axis=2)


def centroid(image: UInt8) -> Float64:
    """Centre of brightness in gsplat's convention (top-left pixel centre at 0.5, 0.5)."""
    weight = image[..., 0].astype(np.float64)
    v, u = np.mgrid[: weight.shape[0], : weight.shape[1]] + 0.5
    return np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("width", [None, 480, 320, 160])
def test_what_the_lens_bends_the_pinhole_camera_sees_straight(lens: str, width: int | None) -> None:
    raw = LENSES[lens]
    undistorter = Undistorter(raw, width)
    camera = undistorter.camera
    scale = camera.width / raw.width
    for point in points_in_view(camera, margin=40 * scale):
        view = undistorter.view(0, spot(raw, raw_pixels(raw, point[None])[0]))
        expected = project(camera.K, camera.viewmat, point[None])[0, :2]
        # The lens bends the spot itself, which moves its centre of brightness by less than a quarter of a raw pixel.
        np.testing.assert_allclose(centroid(view.rgb), expected, atol=0.25 * scale + 0.02)


@pytest.mark.parametrize("lens", LENSES)
def test_every_model_bends_rays_as_opencv_does(lens: str) -> None:
    camera = LENSES[lens]
    rays = np.concatenate([np.zeros((1, 2)), np.random.default_rng(1).normal(0, 0.6, (200, 2))])
    expected = raw_pixels(camera, np.concatenate([rays, np.ones((201, 1))], axis=1))
    np.testing.assert_allclose(distort(camera, rays), expected, rtol=1e-12, atol=1e-9)
    assert distort(camera, rays[:0]).shape == (0, 2)


@pytest.mark.parametrize("count", [0, 4, 5, 8, 14])
def test_coefficients_of_zero_may_be_of_any_number(count: int) -> None:
    """OpenCV gives up to fourteen."""
    camera = replace(PINHOLE, D=np.zeros(count))
    view = Undistorter(camera, 160).view(0, np.zeros((270, 480, 3), np.uint8), np.ones((270, 480), np.float32))
    assert view.depth is not None and (view.depth == 1).all()


def test_numbers_of_a_fisheye_may_be_of_any_kind() -> None:
    """A script's `K` of whole numbers, or in single precision, ended in a trace of OpenCV's."""
    K = np.array([[60, 0, 31], [0, 60, 23], [0, 0, 1]])
    rays = np.array([[0.1, -0.2], [0.4, 0.3]])
    whole = RigCamera("left", 64, 48, K, np.eye(4), "equidistant", np.zeros(4, np.float32))
    expected = distort(replace(whole, K=K.astype(np.float64), D=np.zeros(4)), rays)
    np.testing.assert_array_equal(distort(whole, rays), expected)


def test_full_size_without_distortion_is_the_image_itself() -> None:
    image = RNG.integers(0, 256, (270, 480, 3), dtype=np.uint8)
    view = Undistorter(PINHOLE).view(7, image)
    np.testing.assert_array_equal(view.rgb, image)
    assert (view.stamp, view.depth, view.valid) == (7, None, None)
    np.testing.assert_allclose(view.camera.K, [[250, 0, 236.5], [0, 255, 138.5], [0, 0, 1]])


@pytest.mark.parametrize("lens", LENSES)
def test_fine_texture_is_averaged_and_not_sampled(lens: str) -> None:
    """A chequerboard of single pixels is grey at a third of the size, whatever the lens."""
    v, u = np.mgrid[:270, :480]
    board = np.repeat((((u + v) % 2) * 255).astype(np.uint8)[..., None], 3, axis=2)
    view = Undistorter(LENSES[lens], 160).view(0, board)
    inner = view.rgb[10:-10, 10:-10].astype(int)
    assert np.abs(inner - 127).max() <= 40
    assert np.abs(inner.mean() - 127) < 3


def test_pixels_that_the_lens_never_saw_are_not_valid() -> None:
    pincushion = replace(PINHOLE, D=np.array([0.4, 0.0, 0.0, 0.0, 0.0]))
    white = np.full((270, 480, 3), 255, np.uint8)
    view = Undistorter(pincushion, 160).view(0, white)
    assert view.valid is not None
    assert not view.valid[0, 0]
    assert view.valid[45, 80]
    assert (view.rgb[view.valid] == 255).all()
    assert Undistorter(LENSES["plumb_bob"], 160).view(0, white).valid is None


def test_what_lies_beyond_the_lens_models_reach_is_not_valid() -> None:
    """With k1 = -0.5 the image radius shrinks again beyond 39 degrees: those pixels would show the scene folded."""
    K = PINHOLE.K * [[0.6], [0.6], [1.0]] + [[0, 0, 95.0], [0, 0, 55.0], [0, 0, 0]]
    view = Undistorter(replace(PINHOLE, K=K, D=np.array([-0.5, 0.0, 0.0, 0.0])), 160).view(
        0, np.zeros((270, 480, 3), np.uint8), np.ones((270, 480), np.float32)
    )
    assert view.valid is not None
    assert view.depth is not None
    camera = view.camera
    u, v = np.meshgrid(np.arange(160) + 0.5, np.arange(90) + 0.5)
    angle = np.arctan(np.hypot((u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1]))
    assert not view.valid[angle > np.radians(41)].any()
    assert not view.depth[angle > np.radians(41)].any()
    assert view.valid[angle < np.radians(37)].all()


@pytest.mark.parametrize(
    "D", [np.array([-0.45, 0.05, 0.0, 0.0, 0.0]), np.array([-0.404, 0.038, 0.0, 0.0, 0.01])], ids=["mirrored", "again"]
)
def test_what_lies_beyond_a_fold_is_not_valid_where_the_polynomial_turns_again(D: Float64) -> None:
    """The image radius ends at a fold; further out it goes through zero to the other side, or grows once more."""
    K = np.array([[75.0, 0, 159.5], [0, 75, 119.5], [0, 0, 1]])
    camera = RigCamera("wide", 320, 240, K, np.eye(4), "plumb_bob", D)
    view = Undistorter(camera, 160).view(0, np.zeros((240, 320, 3), np.uint8), np.ones((240, 320), np.float32))
    assert view.valid is not None and view.depth is not None
    v, u = np.mgrid[:120, :160] + 0.5
    radius = np.hypot((u - 80) / 37.5, (v - 60) / 37.5)
    square = np.linspace(0, 4, 4001) ** 2
    slope = 1 + square * (3 * D[0] + square * (5 * D[1] + square * 7 * D[4]))
    fold = float(np.sqrt(square[np.argmax(slope <= 0)]))
    assert not view.valid[radius > fold + 0.1].any()
    assert not view.depth[radius > fold + 0.1].any()
    assert view.valid[radius < fold - 0.1].all()


def test_depth_is_picked_and_never_averaged() -> None:
    depth = np.where(np.arange(480) < 240, 1.0, 3.0).astype(np.float32) * np.ones((270, 1), np.float32)
    image = np.zeros((270, 480, 3), np.uint8)
    for lens in LENSES.values():
        view = Undistorter(lens, 160).view(0, image, depth)
        assert view.depth is not None
        assert set(np.unique(view.depth)) <= {0.0, 1.0, 3.0}
        assert view.depth.shape == (90, 160)


def test_depth_falls_where_colour_does() -> None:
    """The edge between near and far lies at the same pixel in depth and in colour."""
    for lens in LENSES.values():
        edge = np.arange(480) >= 300
        image = np.broadcast_to((edge * 255).astype(np.uint8)[None, :, None], (270, 480, 3)).copy()
        depth = np.broadcast_to(np.where(edge, 2.0, 1.0).astype(np.float32), (270, 480)).copy()
        view = Undistorter(lens, 160).view(0, image, depth)
        assert view.depth is not None
        near, far = view.rgb[..., 0] < 20, view.rgb[..., 0] > 235
        known = view.depth > 0
        assert (view.depth[near & known] == 1).all()
        assert (view.depth[far & known] == 2).all()


def test_unknown_depth_is_zero() -> None:
    depth = np.full((270, 480), 1.5, np.float32)
    depth[:90], depth[90:180], depth[180:] = np.nan, -1, np.inf
    view = Undistorter(PINHOLE, 160).view(0, np.zeros((270, 480, 3), np.uint8), depth)
    assert view.depth is not None
    assert not view.depth.any()


def test_the_view_has_a_pose_of_its_own() -> None:
    """Whoever moves a view's camera in place does not move the rig's."""
    assert not np.shares_memory(Undistorter(PINHOLE).camera.T_base_cam, PINHOLE.T_base_cam)


def test_depth_in_whole_millimetres_is_refused() -> None:
    """Taken for metres, all that it measures would be 1 km away and all before it free."""
    with pytest.raises(RigError, match=r"camera cam: expected depth in metres .* found uint16.* divide by 1000"):
        Undistorter(PINHOLE, 160).view(0, np.zeros((270, 480, 3), np.uint8), np.full((270, 480), 1500, np.uint16))


def test_depth_of_another_resolution_covers_the_same_view() -> None:
    depth = np.broadcast_to(np.where(np.arange(240) < 150, 1.0, 2.0).astype(np.float32), (135, 240)).copy()
    view = Undistorter(PINHOLE, 160).view(0, np.zeros((270, 480, 3), np.uint8), depth)
    assert view.depth is not None
    assert (view.depth[:, :99] == 1).all()
    assert (view.depth[:, 101:] == 2).all()


@pytest.mark.parametrize(
    "image",
    [np.zeros((270, 479, 3), np.uint8), np.zeros((270, 480), np.uint8), np.zeros((270, 480, 3), np.float32)],
)
def test_an_image_that_the_calibration_is_not_for(image: UInt8) -> None:
    with pytest.raises(RigError, match="camera cam: expected 8-bit colour images of 480x270"):
        Undistorter(PINHOLE).view(0, image)


@pytest.mark.parametrize(
    ("shape", "is_refused"), [((240, 320), True), ((270, 160), True), ((0, 0), True), ((91, 160), False)]
)
def test_depth_of_another_shape_than_the_images_is_refused(shape: tuple[int, int], is_refused: bool) -> None:
    """Of a part of the image, or another mode: it was stretched over the image, in silence."""
    image, depth = np.zeros((270, 480, 3), np.uint8), np.ones(shape, np.float32)
    if not is_refused:
        assert Undistorter(PINHOLE, 160).view(0, image, depth).depth is not None
        return
    with pytest.raises(RigError, match=rf"camera cam: expected depth .* 480x270.*found {shape[1]}x{shape[0]}"):
        Undistorter(PINHOLE, 160).view(0, image, depth)


def test_depth_with_channels() -> None:
    with pytest.raises(RigError, match=r"camera cam: expected depth \[H, W\]"):
        Undistorter(PINHOLE).view(0, np.zeros((270, 480, 3), np.uint8), np.zeros((270, 480, 1), np.float32))


def test_a_width_of_nothing() -> None:
    with pytest.raises(RigError, match="at least 2x2, found 0x0"):
        Undistorter(PINHOLE, 0)


@settings(max_examples=30, deadline=None)
@given(width=st.integers(2, 700), size=st.tuples(st.integers(2, 300), st.integers(2, 300)))
def test_any_size_keeps_the_view(width: int, size: tuple[int, int]) -> None:
    """Whatever the scale, the corners of the image stay the corners: the pinhole camera sees the same solid angle."""
    raw = replace(PINHOLE, width=size[0], height=size[1], K=np.array([[99.0, 0, 10], [0, 98, 20], [0, 0, 1]]))
    if round(size[1] * width / size[0]) < 2:
        with pytest.raises(RigError, match="at least 2x2"):
            Undistorter(raw, width)
        return
    camera = Undistorter(raw, width).camera
    corner = np.linalg.inv(camera.K) @ [camera.width, camera.height, 1]
    np.testing.assert_allclose(corner, np.linalg.inv(raw.K) @ [size[0] - 0.5, size[1] - 0.5, 1], atol=1e-9)


def test_a_lens_that_is_told_while_another_thread_picks_depth_counts_from_then_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What was being made of the lens before stayed for good: all depth was taken to be of that one."""
    rgb = np.zeros((270, 480, 3), np.uint8)
    depth = np.arange(270 * 480, dtype=np.float32).reshape(270, 480) + 1
    lens = replace(PINHOLE, K=PINHOLE.K * np.array([[0.8], [0.8], [1.0]]))
    undistorter, make = Undistorter(PINHOLE, 120), Undistorter._make_depth_map

    def told_meanwhile(own: Undistorter, shape: tuple[int, int]) -> object:
        made = make(own, shape)
        monkeypatch.undo()
        undistorter.see_depth_by(lens)
        return made

    monkeypatch.setattr(Undistorter, "_make_depth_map", told_meanwhile)
    undistorter.view(0, rgb, depth)
    right = Undistorter(replace(PINHOLE, depth_lens=lens), 120).view(0, rgb, depth)
    assert np.array_equal(undistorter.view(0, rgb, depth).depth, right.depth)
