"""How well a rendering explains an image, over all pixels or some of them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

MOVING_THRESHOLD = 25 / 255
"""Largest channel difference from the first frame that still counts as unchanged (as in DecoGS, 25 grey levels)."""


def squared_error(image: NDArray[np.floating], target: NDArray[np.floating]) -> NDArray[np.float64]:
    """Mean squared error over channels per pixel, [H, W], of two images [H, W, 3] in 0 to 1."""
    difference = np.asarray(image, dtype=np.float64) - np.asarray(target, dtype=np.float64)
    error: NDArray[np.float64] = np.mean(difference * difference, axis=-1)
    return error


def psnr(mean_squared_error: float) -> float:
    """Peak signal-to-noise ratio in dB for a peak of 1; 100 dB at most, so that equal images stay finite."""
    return -10 * math.log10(max(mean_squared_error, 1e-10))


def psnr_on(image: NDArray[np.floating], target: NDArray[np.floating], pixels: NDArray[np.bool_]) -> float:
    """PSNR, dB, of an image [H, W, 3] on some of its pixels [H, W], one at least."""
    return psnr(float(squared_error(image, target)[pixels].mean()))


def moving_pixels(image: NDArray[np.floating], first: NDArray[np.floating]) -> NDArray[np.bool_]:
    """[H, W] True where an image differs from the first frame by more than `MOVING_THRESHOLD` in some channel."""
    moving: NDArray[np.bool_] = np.max(np.abs(image - first), axis=-1) > MOVING_THRESHOLD
    return moving
