"""Barcodes of what moves tell whether a rig explains it, whichever way it is wrong, but not its scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose, looking_at, pose, transform
from twin_node.rig.calibrate.barcodes import BLOCKS, LEAST_SETS, Barcodes, _correlation
from twin_node.rig.calibrate.lenses import pixel_rays, raw_pixels
from twin_node.scene import Camera, Float64, FrameSet, Rig, RigCamera, UInt8, View

WIDTH, HEIGHT = 160, 120
PLACES = ((1.6, 0.0, 0.7), (0.2, 1.5, 1.0), (-1.2, -0.9, 0.8))


def a_rig(cameras: int = 3) -> Rig:
    K = np.array([[150.0, 0, 80], [0, 150.0, 60], [0, 0, 1]])
    D = np.array([-0.1, 0.02, 0.0, 0.0, 0.0])
    return Rig(
        tuple(
            RigCamera(f"cam{i}", WIDTH, HEIGHT, K, looking_at(np.array(place), np.zeros(3)), D=D)
            for i, place in enumerate(PLACES[:cameras])
        ),
        np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]),
    )


def seen(camera: RigCamera, balls: Float64, scale: int, wall: int) -> UInt8:
    """What a camera sees of balls [N, 3] before a wall so bright, at its resolution divided by `scale`."""
    rng = np.random.default_rng(0)
    image = np.full((HEIGHT, WIDTH, 3), wall, np.uint8)
    local = transform(inverse_pose(camera.T_base_cam), balls)
    for (x, y), depth in zip(raw_pixels(camera, local), local[:, 2], strict=True):
        cv2.circle(image, (round(8 * x), round(8 * y)), round(8 * 10 / depth), (200, 60, 40), -1, shift=3)
    image = np.clip(image + rng.normal(0, 1, image.shape), 0, 255).astype(np.uint8)
    size = (WIDTH // scale, HEIGHT // scale)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def recorded(
    rig: Rig, sets: int = 24, scale: int = 1, moves: bool = True, wall: int = 90, first_scale: int | None = None
) -> list[FrameSet]:
    """Two balls that fly about; the first camera's images are divided by a scale of their own."""
    out = []
    for n in range(sets):
        t = 0.9 * n if moves else 0.0
        balls = 0.35 * np.array([[np.sin(t), np.cos(1.3 * t), np.sin(0.7 * t)], [np.cos(0.6 * t + 2), np.sin(t), 0.5]])
        views = []
        scales = [first_scale or scale] + [scale] * (len(rig.cameras) - 1)
        for camera, own in zip(rig.cameras, scales, strict=True):
            known = Camera(camera.name, WIDTH, HEIGHT, camera.K, camera.T_base_cam)
            views.append(View(known, n, seen(camera, balls, own, wall)))
        out.append(FrameSet(n, tuple(views)))
    return out


def with_pose(rig: Rig, number: int, T_base_cam: Float64) -> Rig:
    cameras = list(rig.cameras)
    cameras[number] = replace(cameras[number], T_base_cam=T_base_cam)
    return replace(rig, cameras=tuple(cameras))


def turned(rig: Rig, number: int, rotvec_deg: Sequence[float]) -> Rig:
    """The rig, one of its cameras turned about its own centre."""
    turn = pose(Rotation.from_rotvec(np.radians(rotvec_deg)).as_matrix(), np.zeros(3))
    return with_pose(rig, number, rig.cameras[number].T_base_cam @ turn)


@pytest.mark.parametrize(("scale", "wall"), [(1, 90), (2, 90), (1, 5), (1, 251)])
def test_a_true_rig_explains_what_moves_at_any_size_and_brightness_of_the_images(scale: int, wall: int) -> None:
    rig = a_rig()
    barcodes = Barcodes(rig, recorded(rig, scale=scale, wall=wall))
    assert barcodes.tells
    agreement = barcodes.agreement(rig)
    assert agreement.shape == (BLOCKS,)
    assert agreement.min() > 0.7
    assert agreement.max() <= 1


@pytest.mark.parametrize(("scale", "first_scale"), [(1, 2), (2, 1)])
def test_images_of_different_sizes_are_held_against_the_same_planes(scale: int, first_scale: int) -> None:
    """A right rig with one narrow camera was accused of a mistake."""
    rig = a_rig()
    assert Barcodes(rig, recorded(rig, scale=scale, first_scale=first_scale)).agreement(rig).min() > 0.6


def test_pixels_whose_ray_is_not_known_are_in_no_plane() -> None:
    """The polynomial of this lens cannot be undone in the corners, which ended in a trace."""
    rig = a_rig()
    D = np.array([0.0, 0.1, 0.0, 0.0, 0.0, -0.4, 1.3, 2.1])
    odd = replace(rig.cameras[0], distortion_model="rational_polynomial", D=D)
    corner = np.zeros((1, 2))
    assert np.isnan(pixel_rays(odd, corner)).all()
    assert np.isfinite(Barcodes(rig, recorded(rig)).agreement(replace(rig, cameras=(odd, *rig.cameras[1:])))).all()


@pytest.mark.parametrize("rotvec_deg", [(6, 0, 0), (0, 6, 0), (0, 0, 12), (0, 180, 0)])
@pytest.mark.parametrize("number", [0, 2])
def test_a_camera_that_looks_elsewhere_does_not(number: int, rotvec_deg: Sequence[float]) -> None:
    rig = a_rig()
    barcodes = Barcodes(rig, recorded(rig))
    wrong = barcodes.agreement(turned(rig, number, rotvec_deg)).mean()
    assert wrong < barcodes.agreement(rig).mean() - 0.1


def test_wrong_lenses_do_not_and_the_right_rig_still_does_afterwards() -> None:
    rig = a_rig()
    barcodes = Barcodes(rig, recorded(rig))
    right = barcodes.agreement(rig)
    wide = replace(rig.cameras[0], K=rig.cameras[0].K * np.array([[1.5, 1, 1], [1, 1.5, 1], [1, 1, 1]]))
    assert barcodes.agreement(replace(rig, cameras=(wide, *rig.cameras[1:]))).mean() < right.mean() - 0.1
    np.testing.assert_array_equal(barcodes.agreement(rig), right)


def test_a_rig_of_another_scale_explains_it_as_well() -> None:
    rig = a_rig()
    barcodes = Barcodes(rig, recorded(rig))
    larger = rig
    for i, camera in enumerate(rig.cameras):
        T = camera.T_base_cam.copy()
        T[:3, 3] *= 1000
        larger = with_pose(larger, i, T)
    np.testing.assert_allclose(barcodes.agreement(larger), barcodes.agreement(rig), atol=0.02)


def test_where_nothing_moves_or_too_few_images_are_nothing_is_told() -> None:
    rig = a_rig()
    assert not Barcodes(rig, recorded(rig, moves=False)).tells
    assert not Barcodes(rig, recorded(rig, sets=LEAST_SETS - 1)).tells
    assert Barcodes(rig, recorded(rig, sets=LEAST_SETS)).tells
    alone = [replace(frames, views=frames.views[:1]) for frames in recorded(rig, sets=12)]
    assert not Barcodes(rig, alone).tells


def test_what_moves_before_each_camera_by_itself_fits_no_better_than_by_chance() -> None:
    rig = a_rig()
    own = [recorded(rig, sets=48)[i * 12 : i * 12 + 24] for i in range(3)]
    mixed = [replace(own[0][n], views=tuple(own[i][n].views[i] for i in range(3))) for n in range(24)]
    assert Barcodes(rig, mixed).agreement(rig).mean() < 0.3


@pytest.mark.parametrize(
    ("table", "phi"),
    [
        ((4, 1, 2, 3), 10 / np.sqrt(5 * 6 * 4 * 5)),
        ((5, 0, 0, 5), 1),
        ((0, 5, 5, 0), -1),
        ((1, 1, 1, 1), 0),
        ((5, 0, 0, 0), 0),
    ],
)
def test_the_correlation_is_matthews_s(table: Sequence[float], phi: float) -> None:
    assert _correlation(np.array(table, dtype=np.float64)) == pytest.approx(phi)
