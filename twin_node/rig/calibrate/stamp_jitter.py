"""How far off single stamps of a camera are, as the delays of its images tell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.bundle_equations import BundleEquations
from twin_node.scene import Float64

JITTER_SIGMA_S, LEAST_JITTER_S, MOST_JITTER_S = 0.005, 2e-5, 0.04
"""1 sigma of what single stamps are off by: at first; from the second round on what was measured, within the others.
Webcams' images are stamped when they arrive, some milliseconds sooner or later; what is worse is another clock."""

JITTER_FALL = 5.0
"""The most that a round takes from it: what is thought of as certain would not be doubted again."""

FAR_SIGMAS, FAR_SHARE = 2.0, 0.92
"""Delays count for so many sigmas at most, and what is left of a normal distribution's variance then: one image whose
delay the solver was led astray by, or that was misread, says nothing of its camera's stamps."""

LEAST_TOLD_IMAGES = 1.0
"""Delays are told by so many images at least: where a camera saw the board alone its course takes them all up."""


def measured_jitter(
    equations: BundleEquations, jitter_s: Float64, delays: Float64, cameras: NDArray[np.int64]
) -> Float64:
    """[C] 1 sigma of what stamps are off by, s, beyond what noise of the corners makes of them.

    `equations`: about a state with `delays` [V], which were as likely as `jitter_s` [C] says; `cameras` [V]: of each
    image, another number where the image is not used.
    """
    variances, measured = equations.delay_variances(), jitter_s.copy()
    for camera, jitter in enumerate(jitter_s):
        own = cameras == camera
        told = 1 - variances[own] / jitter**2  # 0: of the delay nothing is known but the jitter
        noise = told * variances[own]
        likely = told**2 * jitter**2 + noise
        square = float((np.minimum(delays[own] ** 2, FAR_SIGMAS**2 * likely) / FAR_SHARE - noise).sum())
        square /= max(float((told**2).sum()), LEAST_TOLD_IMAGES)
        measured[camera] = np.clip(np.sqrt(max(square, 0.0)), max(jitter / JITTER_FALL, LEAST_JITTER_S), MOST_JITTER_S)
    return measured
