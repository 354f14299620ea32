"""How far two depths of one surface may differ by a camera's noise alone."""

from __future__ import annotations

import numpy as np

from twin_node.scene.arrays import Float32

NOISE_SIGMAS = 5.0
"""Of a camera's own noise: by less than so much of it depths differ by chance."""
MOST_NOISE = 0.25
"""Share of a depth beyond which it would tell nothing: noise counts for no more, however far away."""


def noise_slack(depth: Float32, noise: float) -> Float32:
    """How far depths [...] (m) may be off by chance, m.

    `noise`: 1 sigma at 1 m, m; it grows with the square of the depth, as for stereo (Khoshelham 2012).
    """
    share = np.minimum(np.float32(NOISE_SIGMAS * noise) * depth, np.float32(MOST_NOISE))
    slack: Float32 = share * depth
    return slack
