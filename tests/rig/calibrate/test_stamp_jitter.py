"""What stamps are off by is told by delays of single images, which take up noise of the corners as well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from twin_node.rig.calibrate.bundle_equations import BundleEquations
from twin_node.rig.calibrate.stamp_jitter import (
    JITTER_FALL,
    JITTER_SIGMA_S,
    LEAST_JITTER_S,
    MOST_JITTER_S,
    measured_jitter,
)
from twin_node.scene import Float64

IMAGES = 4000


@dataclass
class Solved:
    """Images whose delays a solver has told from corners with an error, beside what jitter lets them be."""

    true_s: Float64
    """[V] what each stamp is off by."""
    error_s: Float64
    """[V] 1 sigma of what the corners tell of that."""
    cameras: NDArray[np.int64]

    def round(self, jitter_s: Float64) -> Float64:
        """[C] the jitter that a round measures where the one before had `jitter_s`."""
        prior, error = jitter_s[np.maximum(self.cameras, 0)] ** 2, self.error_s**2
        told = self.true_s + self.error_s * np.random.default_rng(1).normal(size=len(self.true_s))
        delays, variances = told * prior / (prior + error), prior * error / (prior + error)
        equations = cast(BundleEquations, type("Stub", (), {"delay_variances": lambda _: variances})())
        return measured_jitter(equations, jitter_s, delays, self.cameras)

    def settled(self, rounds: int = 12) -> Float64:
        jitter = np.full(self.cameras.max() + 1, JITTER_SIGMA_S)
        for _ in range(rounds):
            jitter = self.round(jitter)
        return jitter


def images(sigma_s: float, error_s: float, camera: int = 0, seed: int = 0) -> Solved:
    true = sigma_s * np.random.default_rng(seed).normal(size=IMAGES)
    return Solved(true, np.full(IMAGES, error_s), np.full(IMAGES, camera))


@pytest.mark.parametrize("sigma_s", [0.001, 0.004, 0.02])
@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_the_jitter_is_found_whatever_the_corners_noise_makes_of_delays(sigma_s: float, share: float) -> None:
    assert images(sigma_s, share * sigma_s).settled()[0] == pytest.approx(sigma_s, rel=0.08)


def test_each_camera_has_its_own_and_images_that_are_not_used_tell_nothing() -> None:
    first, second, unused = images(0.003, 0.001), images(0.01, 0.001, 1, seed=2), images(0.039, 0.001, -1)
    parts = (first, second, unused)
    together = Solved(
        np.concatenate([p.true_s for p in parts]),
        np.concatenate([p.error_s for p in parts]),
        np.concatenate([p.cameras for p in parts]),
    )
    np.testing.assert_allclose(together.settled(), [0.003, 0.01], rtol=0.06)


def test_stamps_that_are_right_are_believed_step_by_step() -> None:
    right = images(0.0, 0.0005)
    once = right.round(np.array([JITTER_SIGMA_S]))[0]
    assert once == pytest.approx(JITTER_SIGMA_S / JITTER_FALL)
    assert right.settled(4)[0] < 1e-4
    assert images(0.0, 1e-7).settled()[0] == pytest.approx(LEAST_JITTER_S)


def test_no_jitter_is_larger_than_what_is_refused() -> None:
    assert images(0.5, 0.001).settled()[0] == MOST_JITTER_S


def test_delays_that_the_course_takes_up_tell_no_jitter() -> None:
    """A camera that saw the board alone: nothing is known of its delays but the jitter."""
    alone = Solved(np.zeros(6), np.full(6, 10.0), np.zeros(6, np.int64))
    assert alone.settled()[0] == pytest.approx(LEAST_JITTER_S)


def test_few_images_that_are_far_off_count_no_more_than_likely_ones() -> None:
    few = images(0.002, 0.0005)
    few.true_s[:40] = 0.5
    assert few.settled()[0] == pytest.approx(0.002, rel=0.15)
