"""Flow tells by how much of a pixel things have moved, and is sought where it is wanted alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from twin_node.model.flow import flows
from twin_node.model.kernels import kernels
from twin_node.model.patch_flow import SIDE, WIDTH, flow_between
from twin_node.scene import Bool, Float32, UInt8

SIZE = (70, 94)
SIZES = [SIZE, (45, 33), (16, 40), (9, 8), (7, 30), (33, 70)]


def textured(shape: tuple[int, int], seed: int = 0) -> Float32:
    """[H, W, 3] smooth colours, 0 to 1."""
    noise = np.random.default_rng(seed).random((*shape, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    out: Float32 = ((smooth - smooth.min()) / (smooth.max() - smooth.min())).astype(np.float32)
    return out


def moved(rgb: Float32, shift: tuple[float, float], gain: float = 1.0, offset: float = 0.0) -> UInt8:
    """[H, W, 3] the image whose things are `shift` pixels (right, down) further on."""
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], np.float32)
    flat = cv2.warpAffine(rgb, matrix, rgb.shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.rint(255 * (gain * flat + offset)).clip(0, 255).astype(np.uint8)


def with_depth(rgb: Float32) -> Float32:
    """[H, W, 4]."""
    return np.concatenate([rgb, np.ones((*rgb.shape[:2], 1), np.float32)], -1)


def middle(shape: tuple[int, int] = SIZE) -> Bool:
    """[H, W] a block in the middle."""
    wanted = np.zeros(shape, bool)
    wanted[20:44, 30:62] = True
    return wanted


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (2.6, 1.2), (-5.3, 3.7), (7.5, -6.5)])
def test_the_flow_is_the_shift_to_a_tenth_of_a_pixel(shift: tuple[float, float]) -> None:
    rgb, wanted = textured(SIZE), middle()
    [flow] = flows([with_depth(rgb)], [moved(rgb, shift)], [wanted])
    errors = np.linalg.norm(flow[wanted] - np.array(shift, np.float32), axis=-1)
    assert np.median(errors) < 0.08
    assert np.percentile(errors, 95) < 0.1


def test_a_brighter_image_has_not_moved() -> None:
    rgb, wanted = 0.2 + 0.6 * textured(SIZE), middle()
    [flow] = flows([with_depth(rgb)], [moved(rgb, (1.5, -0.5), 1.0, 0.12)], [wanted])
    assert np.median(np.linalg.norm(flow[wanted] - np.array([1.5, -0.5], np.float32), axis=-1)) < 0.05


def test_two_things_side_by_side_go_each_its_own_way() -> None:
    left, right, wanted = textured(SIZE), textured(SIZE, 1), np.ones(SIZE, bool)
    half = SIZE[1] // 2
    shown = np.concatenate([left[:, :half], right[:, half:]], 1)
    came = np.concatenate([moved(left, (0, 2.0))[:, :half], moved(right, (0, -2.0))[:, half:]], 1)
    [flow] = flows([with_depth(shown)], [came], [wanted])
    inside = slice(10, -10)
    assert np.median(flow[inside, 5 : half - SIDE, 1]) == pytest.approx(2, abs=0.05)
    assert np.median(flow[inside, half + SIDE : -5, 1]) == pytest.approx(-2, abs=0.05)


def test_nothing_is_sought_where_nothing_is_wanted() -> None:
    rgb, wanted = textured(SIZE), middle()
    [flow] = flows([with_depth(rgb)], [moved(rgb, (2.0, 1.0))], [wanted])
    far = cv2.dilate(wanted.astype(np.uint8), np.ones((2 * SIDE + 1, 2 * SIDE + 1), np.uint8)) == 0
    assert flow[wanted].all(1).all() and not flow[far].any()
    [none] = flows([with_depth(rgb)], [moved(rgb, (2.0, 1.0))], [np.zeros(SIZE, bool)])
    assert not none.any()


def test_what_is_even_tells_no_motion() -> None:
    even = np.full((*SIZE, 3), 0.5, np.float32)
    noise = np.random.default_rng(2).normal(0, 1, (*SIZE, 3))
    image = (127.5 + noise).clip(0, 255).astype(np.uint8)
    [flow] = flows([with_depth(even)], [image], [middle()])
    assert np.abs(flow).max() < 0.5


def test_a_rendering_with_what_is_no_number_tells_the_motion_of_the_rest() -> None:
    rgb, wanted = textured(SIZE), np.ones(SIZE, bool)
    broken = rgb.copy()
    broken[30:40, 40:50] = np.nan
    for flow in (
        flows([with_depth(broken)], [moved(rgb, (1.0, 0.0))], [wanted])[0],
        flow_between(broken, moved(rgb, (1.0, 0.0)), wanted),
    ):
        assert np.isfinite(flow).all()
        assert np.median(np.linalg.norm(flow[:, :24] - np.array([1, 0], np.float32), axis=-1)) < 0.1


@pytest.mark.parametrize("shift", [(0.0, 0.0), (1.4, -0.6), (-5.3, 3.7), (15.0, -12.5)])
def test_in_wide_images_the_flow_is_the_shift_to_a_fifth_of_a_pixel_and_found_twice_as_far(
    shift: tuple[float, float],
) -> None:
    shape = (141, 2 * WIDTH + 1)
    rgb, wanted = textured(shape), middle(shape)
    [flow] = flows([with_depth(rgb)], [moved(rgb, shift)], [wanted])
    errors = np.linalg.norm(flow[wanted] - np.array(shift, np.float32), axis=-1)
    assert np.median(errors) < 0.16
    assert np.percentile(errors, 95) < 0.2
    far = cv2.dilate(wanted.astype(np.uint8), np.ones((4 * SIDE + 1, 4 * SIDE + 1), np.uint8)) == 0
    assert not flow[far].any()


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
def test_compiled_flow_is_that_in_numpy() -> None:
    random = np.random.default_rng(3)
    shown, images, wanted = [], [], []
    for number, shape in enumerate([*SIZES, (37, 645), (15, 1290)]):
        rgb = textured(shape, number)
        mask = cv2.GaussianBlur(random.random(shape), (0, 0), 3.0) > 0.5
        shown.append(with_depth(rgb))
        images.append(moved(rgb, tuple(random.uniform(-3, 3, 2))))
        wanted.append(mask)
    for rgbd, image, mask, flow in zip(shown, images, wanted, flows(shown, images, wanted), strict=True):
        plain = flow_between(rgbd[..., :3], image, mask)
        assert plain.shape == flow.shape == (*mask.shape, 2)
        assert plain.dtype == flow.dtype == np.float32
        assert np.mean(np.abs(plain - flow) > 0.01) < 0.01
