"""Motion experts on trajectories with known futures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.experts import (
    EXPERTS,
    LAGS,
    Autoregression,
    History,
    constant_acceleration,
    constant_velocity,
    damped,
    mix,
    persistence,
    steps,
)

HORIZONS = np.array([0.0, 0.1, 0.2])


def history(positions: np.ndarray, period: float = 0.02) -> History:
    return History(period * np.arange(len(positions)) + 5.0, positions)


def polynomial(coefficients: np.ndarray, times: np.ndarray) -> np.ndarray:
    """[T, M, 3] of coefficients [D, M, 3]."""
    return np.einsum("td,dmc->tmc", np.vander(times, len(coefficients), increasing=True), coefficients)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 20), st.floats(0.01, 0.1))
def test_constant_velocity_is_exact_on_straight_lines(seed: int, samples: int, period: float) -> None:
    line = np.random.default_rng(seed).normal(size=(2, 4, 3))
    times = period * np.arange(samples)
    forecast = constant_velocity(history(polynomial(line, times), period), HORIZONS)
    assert np.allclose(forecast, line[1] * HORIZONS[:, None, None], atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(5, 20))
def test_constant_acceleration_is_exact_on_parabolas(seed: int, samples: int) -> None:
    parabola = np.random.default_rng(seed).normal(size=(3, 4, 3))
    times = 0.03 * np.arange(samples)
    positions = polynomial(parabola, times)
    expected = polynomial(parabola, times[-1] + HORIZONS) - positions[-1]
    assert np.allclose(constant_acceleration(history(positions, 0.03), HORIZONS), expected, atol=1e-8)


def test_damping_stays_between_persistence_and_constant_velocity() -> None:
    line = history(polynomial(np.ones((2, 1, 3)), 0.02 * np.arange(10)))
    ahead = damped(line, HORIZONS)[1:, 0, 0]
    assert np.all(ahead > persistence(line, HORIZONS)[1:, 0, 0])
    assert np.all(ahead < constant_velocity(line, HORIZONS)[1:, 0, 0])


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_every_expert_copes_with_short_histories(samples: int) -> None:
    short = history(np.zeros((samples, 2, 3)))
    for expert in (*EXPERTS, Autoregression(0.2).forecast):
        assert np.array_equal(expert(short, HORIZONS), np.zeros((3, 2, 3)))


def test_steps_are_newest_first_and_interpolated() -> None:
    positions = polynomial(np.array([[[0.0, 0, 0]], [[0.5, 0, 0]], [[1.0, 0, 0]]]), 0.02 * np.arange(20))
    found = steps(history(positions))
    assert found.shape == (1, 3, LAGS)
    assert np.all(np.diff(found[0, 0]) < 0)
    assert np.allclose(found[0, 1:], 0)


def test_autoregression_learns_an_oscillation_that_straight_lines_miss() -> None:
    times = np.arange(0, 6, 0.0165)
    phases = np.array([0.0, 1.0, 2.0])
    positions = 0.2 * np.sin(2 * np.pi * 1.2 * times[:, None, None] + phases[None, :, None] + np.arange(3))
    ahead = round(0.2 / 0.0165)
    expert = Autoregression(0.2)
    ours, straight = [], []
    for now in range(20, len(times)):
        recent = History(times[now - 19 : now + 1], positions[now - 19 : now + 1])
        if now - ahead >= 20:
            then = History(times[now - ahead - 19 : now - ahead + 1], positions[now - ahead - 19 : now - ahead + 1])
            expert.learn(steps(then), positions[now] - positions[now - ahead], times[now] - times[now - ahead])
        if now > 200 and now + ahead < len(times):
            true = positions[now + ahead] - positions[now]
            horizon = np.array([times[now + ahead] - times[now]])
            ours.append(np.linalg.norm(expert.forecast(recent, horizon)[0] - true, axis=-1).mean())
            straight.append(np.linalg.norm(constant_velocity(recent, horizon)[0] - true, axis=-1).mean())
    assert np.mean(ours) < 0.15 * np.mean(straight)


def test_mixture_prefers_the_expert_that_did_best() -> None:
    weights = mix(np.array([[0.02, 0.3], [0.2, 0.3], [0.2, 0.01]]))
    assert np.allclose(weights.sum(axis=0), 1)
    assert weights[0, 0] > 0.95
    assert weights[2, 1] > 0.95
