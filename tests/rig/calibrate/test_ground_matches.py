"""Two sheets of one ground: the map that most patches agree on, and what is measured about it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from twin_node.rig.calibrate.birds_eye import Sheet
from twin_node.rig.calibrate.ground_matches import MAX_SHIFT_PX, GroundMap, agreed_map, measured
from twin_node.scene import Bool, Float32, Float64

WIDTH, HEIGHT = 270, 240
TRUE = np.array([[1.015, -0.03, 24.5], [0.028, 0.99, -23.25]])
"""Sheet pixels of a to those of b."""


def ground(seed: int = 0) -> Float32:
    rng = np.random.default_rng(seed)
    blobs = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 2.5)
    return np.asarray(0.15 * blobs / blobs.std(), np.float32)


def known(margin: int = 0) -> Bool:
    out = np.zeros((HEIGHT, WIDTH), np.bool_)
    out[margin : HEIGHT - margin, margin : WIDTH - margin] = True
    return out


def seen_under(affine: Float64, image: Float32, noise: float = 0.02) -> Sheet:
    """The sheet of b, where that of a is `image`."""
    moved = cv2.warpAffine(image, affine, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    inside = cv2.warpAffine(np.ones_like(image), affine, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR) > 0.99
    noisy = moved + np.random.default_rng(5).normal(0, noise, moved.shape)
    return Sheet((noisy * inside).astype(np.float32), inside)


def corners() -> Float64:
    return np.array([[50.0, 50.0], [190.0, 50.0], [50.0, 190.0], [190.0, 190.0]])


def under(affine: Float64, points: Float64) -> Float64:
    return np.asarray(points @ affine[:, :2].T + affine[:, 2])


def test_the_map_is_found_and_is_the_only_one() -> None:
    agreed = agreed_map(Sheet(ground(), known()), seen_under(TRUE, ground()))
    assert agreed is not None
    np.testing.assert_allclose(under(agreed.affine, corners()), under(TRUE, corners()), atol=2.0)
    assert agreed.agreement > 0.6
    assert agreed.rival < 0.5
    assert agreed.distinctness == pytest.approx((1 - agreed.rival) / (1 - agreed.agreement))


def test_a_pattern_that_repeats_has_a_rival_that_fits_as_well() -> None:
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    tiles = (0.2 * np.sin(2 * np.pi * x / 12) * np.sin(2 * np.pi * y / 12)).astype(np.float32)
    shift = np.array([[1.0, 0.0, 3.0], [0.0, 1.0, -2.0]])
    agreed = agreed_map(Sheet(tiles, known()), seen_under(shift, tiles, noise=0.03))
    assert agreed is not None
    assert agreed.distinctness < 1.5


def test_too_little_that_both_know_or_that_has_texture_gives_no_map() -> None:
    a, b = Sheet(ground(), known()), seen_under(TRUE, ground())
    assert agreed_map(Sheet(a.contrast, known(90)), b) is None
    assert agreed_map(a, Sheet(b.contrast, known(110))) is None
    assert agreed_map(Sheet(0.05 * a.contrast, a.known), b) is None


def test_what_lies_beyond_the_largest_shift_is_not_found() -> None:
    far = np.array([[1.0, 0.0, MAX_SHIFT_PX + 20.0], [0.0, 1.0, 0.0]])
    agreed = agreed_map(Sheet(ground(), known()), seen_under(far, ground()))
    assert agreed is None or agreed.agreement < 0.5


def test_patches_are_measured_to_a_fraction_of_a_pixel() -> None:
    about = TRUE + np.array([[0.0, 0.0, 1.3], [0.0, 0.0, -1.6]])
    matches = measured(Sheet(ground(), known()), seen_under(TRUE, ground()), about)
    assert len(matches.a) == len(matches.b) > 100
    off = matches.b - under(TRUE, matches.a)
    assert np.abs(np.median(off, axis=0)).max() < 0.05
    assert np.sqrt((off**2).mean()) < 0.2


def test_patches_that_show_something_else_are_left_out() -> None:
    b = seen_under(TRUE, ground())
    thing, shifted = np.s_[70:140, 80:150], seen_under(TRUE + np.array([[0, 0, 3.5], [0, 0, -3.5]]), ground())
    other = b.contrast.copy()
    other[thing] = shifted.contrast[thing]
    matches = measured(Sheet(ground(), known()), Sheet(other, b.known), TRUE)
    assert len(matches.a) > 150
    assert np.abs(matches.b - under(TRUE, matches.a)).max() < 2.0
    assert not ((matches.b > [94, 84]) & (matches.b < [136, 126])).all(axis=1).any()
    strange = measured(Sheet(ground(), known()), seen_under(TRUE, ground(1)), TRUE)
    assert len(strange.a) < 20


def test_nothing_is_measured_where_one_does_not_know() -> None:
    b = seen_under(TRUE, ground())
    hidden = b.known.copy()
    hidden[:, :120] = False
    matches = measured(Sheet(ground(), known(20)), Sheet(b.contrast, hidden), TRUE)
    assert len(matches.a) > 20
    assert matches.b[:, 0].min() > 110
    assert len(measured(Sheet(ground(), known()), Sheet(b.contrast, np.zeros_like(hidden)), TRUE).a) == 0


def test_distinctness_of_maps_that_fit_alike_is_one() -> None:
    assert GroundMap(TRUE, 0.7, 0.7).distinctness == pytest.approx(1)
    assert GroundMap(TRUE, 0.9, 0.7).distinctness == pytest.approx(3)
    assert np.isfinite(GroundMap(TRUE, 1.0, 0.7).distinctness)
