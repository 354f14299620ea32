"""PSNR and the moving-pixel mask against values worked out by hand."""

import numpy as np
import pytest

from twin_node.model import quality


def test_psnr_of_a_uniform_error() -> None:
    image = np.full((4, 5, 3), 0.6)
    error = quality.squared_error(image, np.full((4, 5, 3), 0.5))
    assert error.shape == (4, 5)
    assert quality.psnr(float(error.mean())) == pytest.approx(20.0)


def test_equal_images_stay_finite() -> None:
    assert quality.psnr(0.0) == pytest.approx(100.0)


def test_a_pixel_moves_when_one_channel_differs_enough() -> None:
    first = np.zeros((1, 3, 3))
    image = first.copy()
    image[0, 1, 2] = 26 / 255
    image[0, 2] = 24 / 255
    np.testing.assert_array_equal(quality.moving_pixels(image, first), [[False, True, False]])
