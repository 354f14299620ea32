"""What the 14 numbers of a Gaussian that learns are, column by column."""

from __future__ import annotations

MEAN, QUAT, LOG_SCALE, LOGIT, RGB = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 11), slice(11, 14)
"""Mean (m), quaternion w x y z, log scale (log m), opacity logit and linear colour."""
WIDTH = 14
