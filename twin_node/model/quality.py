"""How well a rendering explains an image, over all pixels or some of them."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.floating)

MOVING_THRESHOLD = 25 / 255
"""Largest channel difference from the first frame that still counts as unchanged (as in DecoGS, 25 grey levels)."""


def squared_error(image: NDArray[np.floating], target: NDArray[np.floating]) -> NDArray[np.float64]:
    """Mean squared error over channels per pixel, [H, W], of two images [H, W, 3] in 0 to 1."""
    squares = np.subtract(image, target, dtype=np.float64)
    np.square(squares, out=squares)
    error: NDArray[np.float64] = (squares[..., 0] + squares[..., 1] + squares[..., 2]) / 3
    return error


def largest_channel(a: NDArray[Number], b: NDArray[Number]) -> NDArray[Number]:
    """[H, W] the largest difference of a channel between images [H, W, 3]."""
    difference = np.abs(a - b)
    largest: NDArray[Number] = np.maximum(np.maximum(difference[..., 0], difference[..., 1]), difference[..., 2])
    return largest


def psnr(mean_squared_error: float) -> float:
    """Peak signal-to-noise ratio in dB for a peak of 1; 100 dB at most, so that equal images stay finite."""
    return -10 * math.log10(max(mean_squared_error, 1e-10))


def psnr_on(image: NDArray[np.floating], target: NDArray[np.floating], pixels: NDArray[np.bool_]) -> float:
    """PSNR, dB, of an image [H, W, 3] on some of its pixels [H, W], one at least."""
    return psnr(float(squared_error(image, target)[pixels].mean()))


def moving_pixels(image: NDArray[np.floating], first: NDArray[np.floating]) -> NDArray[np.bool_]:
    """[H, W] True where an image differs from the first frame by more than `MOVING_THRESHOLD` in some channel."""
    return largest_channel(image, first) > MOVING_THRESHOLD
