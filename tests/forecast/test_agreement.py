"""Velocities that views agree on: the compiled ones against the plain ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.agreement import Estimate, Sighting, agreed, agreed_reference
from twin_node.forecast.kernels import kernels
from twin_node.forecast.measured import UNKNOWN_SPEED
from twin_node.forecast.things import Whole
from twin_node.scene import Float64


def sighting(velocities: Float64, rng: np.random.Generator, noise: float = 0.0) -> Sighting:
    """A view of parts that move so, some of which it does not show, or not their depth."""
    count, elapsed_s = len(velocities), float(rng.uniform(0.02, 0.1))
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    jacobian = 80 * rng.normal(size=(count, 2, 3))
    shifts = np.einsum("mki,mi->mk", jacobian, velocities) * elapsed_s
    shown = rng.uniform(size=count) < 0.8
    return Sighting(
        elapsed_s,
        jacobian,
        shifts + noise * rng.normal(size=shifts.shape),
        np.where(shown, rng.uniform(0.1, 1, count), np.inf),
        shown,
        axis,
        velocities @ axis * elapsed_s,
        np.where(rng.uniform(size=count) < 0.5, rng.uniform(0.5, 3, count), np.inf),
    )


def unexpected(count: int) -> Estimate:
    return Estimate(np.zeros((count, 3)), np.full(count, UNKNOWN_SPEED))


def nothing_whole(count: int) -> Whole:
    return Whole.none(count)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 30))
def test_compiled_velocities_are_the_plain_ones(seed: int, views: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    velocities = rng.normal(size=(count, 3))
    sightings = [sighting(velocities, rng, noise=3.0) for _ in range(views)]
    expected = Estimate(velocities + rng.normal(size=(count, 3)), rng.uniform(0.05, UNKNOWN_SPEED, count))
    sigmas = np.where(rng.uniform(size=count) < 0.3, 0.2, np.inf)
    whole = replace(Whole.none(count), velocities=rng.normal(size=(count, 3)), sigmas=sigmas)
    whole.falling[:] = np.isfinite(sigmas) & (rng.uniform(size=count) < 0.5)
    (one, lost), (other, lost_reference) = (find(sightings, expected, whole) for find in (agreed, agreed_reference))
    assert np.array_equal(lost, lost_reference) and len(lost) == views
    np.testing.assert_allclose(one.velocities, other.velocities, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(one.sigmas, other.sigmas, rtol=1e-7)


def test_views_that_agree_are_believed_and_one_at_odds_is_not() -> None:
    rng = np.random.default_rng(3)
    velocities = rng.normal(size=(20, 3))
    sightings = [sighting(velocities, rng) for _ in range(4)]
    astray = sighting(velocities + 2.0, rng)
    found, lost = agreed([*sightings, astray], unexpected(20), nothing_whole(20))
    assert lost[-1]
    assert np.median(np.linalg.norm(found.velocities - velocities, axis=1)) < 0.05


def test_what_no_view_shows_moves_as_expected() -> None:
    expected = Estimate(np.array([[0.3, 0.0, -0.1]]), np.array([0.2]))
    found, _ = agreed([], expected, nothing_whole(1))
    np.testing.assert_allclose(found.velocities, expected.velocities)
    np.testing.assert_allclose(found.sigmas, expected.sigmas)
