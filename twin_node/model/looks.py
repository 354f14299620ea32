"""What surfaces look like whatever light falls on them, so that bodies can be told apart by their colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Float64

LIKE = 0.07
"""Difference of hue within which two bodies look alike: half of that between a white arm and an orange block that it
lights; light and shade of one surface differ by less than 0.05."""
DARKEST = 0.05
"""Sum of the channels under which a colour has no hue to speak of: four grey levels each."""


def hues(rgb: Float64) -> Float64:
    """[n, 3] the share of each channel in colours [n, 3], 0 to 1."""
    shares: Float64 = rgb / np.maximum(rgb.sum(1), DARKEST)[:, None]
    return shares


def mean_hues(rgb: Float64, bodies: NDArray[np.int64], count: int) -> Float64:
    """[count, 3] of bodies with parts of colours `rgb` [n, 3]; `bodies` [n] says whose each is. 0 of those without."""
    bright = rgb.sum(1)
    sums = np.stack([np.bincount(bodies, weights=share * bright, minlength=count) for share in hues(rgb).T], 1)
    means: Float64 = sums / np.maximum(np.bincount(bodies, weights=bright, minlength=count), DARKEST)[:, None]
    return means
