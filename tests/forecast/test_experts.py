"""Motion experts on trajectories with known futures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.experts import (
    BOUNCE,
    EXPERT_NAMES,
    EXPERTS,
    GRAVITY,
    KNOTS,
    LAGS,
    Autoregression,
    History,
    autoregression_features,
    constant_acceleration,
    constant_velocity,
    damped,
    free_fall,
    mix,
    persistence,
    steps,
)
from twin_node.forecast.neighbours import Neighbours
from twin_node.scene import MotionExpert

HORIZONS = np.array([0.0, 0.1, 0.2])


def history(positions: np.ndarray, period: float = 0.02) -> History:
    return History(period * np.arange(len(positions)) + 5.0, positions)


def polynomial(coefficients: np.ndarray, times: np.ndarray) -> np.ndarray:
    """[T, M, 3] of coefficients [D, M, 3]."""
    return np.einsum("td,dmc->tmc", np.vander(times, len(coefficients), increasing=True), coefficients)


def test_experts_are_called_as_on_the_wire() -> None:
    named = [expert for expert in MotionExpert if expert is not MotionExpert.NO_EXPERT]
    assert [expert.name.lower() for expert in named] == list(EXPERT_NAMES)
    assert [int(expert) for expert in named] == list(range(len(EXPERT_NAMES)))


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
    for expert in EXPERTS:
        assert np.array_equal(expert(short, HORIZONS), np.zeros((3, 2, 3)))
    features = autoregression_features(short, Neighbours(short.positions[-1]))
    assert np.array_equal(Autoregression().forecast(features, HORIZONS), np.zeros((3, 2, 3)))


def test_steps_are_newest_first_and_interpolated() -> None:
    positions = polynomial(np.array([[[0.0, 0, 0]], [[0.5, 0, 0]], [[1.0, 0, 0]]]), 0.02 * np.arange(20))
    found = steps(history(positions))
    assert found.shape == (1, 3, LAGS)
    assert np.all(np.diff(found[0, 0]) < 0)
    assert np.allclose(found[0, 1:], 0)


def swinging(times: np.ndarray) -> np.ndarray:
    """[T, 3, 3] points that swing at 1.2 Hz, a metre apart."""
    phases = np.array([0.0, 1.0, 2.0])
    swing = 0.2 * np.sin(2 * np.pi * 1.2 * times[:, None, None] + phases[None, :, None] + np.arange(3))
    return swing + np.arange(3)[None, :, None]


def test_autoregression_learns_an_oscillation_that_straight_lines_miss() -> None:
    times = np.arange(0, 6, 0.0165)
    positions = swinging(times)
    ahead = round(0.2 / 0.0165)
    expert = Autoregression()
    features, ours, straight = {}, [], []
    for now in range(20, len(times)):
        recent = History(times[now - 19 : now + 1], positions[now - 19 : now + 1])
        features[now] = autoregression_features(recent, Neighbours(positions[now]))
        if now - ahead >= 20:
            expert.learn(len(KNOTS) - 1, features[now - ahead], positions[now] - positions[now - ahead], 0.0165)
        if now > 200 and now + ahead < len(times):
            true = positions[now + ahead] - positions[now]
            horizon = np.array([times[now + ahead] - times[now]])
            ours.append(np.linalg.norm(expert.forecast(features[now], np.ones(1))[0] - true, axis=-1).mean())
            straight.append(np.linalg.norm(constant_velocity(recent, horizon)[0] - true, axis=-1).mean())
    assert np.mean(ours) < 0.15 * np.mean(straight)


def test_autoregression_turns_with_the_frame() -> None:
    rng = np.random.default_rng(1)
    features, moved = rng.normal(size=(30, 3, 3 * LAGS)), rng.normal(size=(30, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    plain, turned = Autoregression(), Autoregression()
    plain.learn(0, features, moved, 1.0)
    turned.learn(0, np.einsum("ij,mjf->mif", turn, features), moved @ turn.T, 1.0)
    share = np.array([KNOTS[0]])
    ahead = plain.forecast(features, share) @ turn.T
    assert np.allclose(turned.forecast(np.einsum("ij,mjf->mif", turn, features), share), ahead, atol=1e-9)


def test_a_neighbour_tells_where_a_node_will_go() -> None:
    """One point repeats 200 ms later what the other does now: only who looks at neighbours can foresee it."""
    rng = np.random.default_rng(2)
    lead = np.cumsum(rng.normal(0, 0.02, (400, 1, 3)), axis=0)
    late = np.concatenate([np.zeros((6, 1, 3)), lead[:-6]])
    positions = np.concatenate([lead, late + np.array([0.1, 0, 0])], axis=1)
    times = 0.033 * np.arange(400)
    expert, features, ours, still = Autoregression(), {}, [], []
    for now in range(12, 394):
        recent = History(times[now - 11 : now + 1], positions[now - 11 : now + 1])
        features[now] = autoregression_features(recent, Neighbours(positions[now]))
        if now >= 18:
            expert.learn(len(KNOTS) - 1, features[now - 6][1:], (positions[now] - positions[now - 6])[1:], 0.033)
        if now > 250:
            true = (positions[now + 6] - positions[now])[1]
            ours.append(np.linalg.norm(expert.forecast(features[now], np.ones(1))[0, 1] - true))
            still.append(np.linalg.norm(true))
    assert np.mean(ours) < 0.6 * np.mean(still)


def test_averages_reach_as_far_as_they_should() -> None:
    around = Neighbours(np.array([[0.0, 0, 0], [0.1, 0, 0], [0.6, 0, 0], [9.0, 0, 0]]))
    near, body = around.near(np.eye(4)), around.body(np.eye(4))
    for weights in (near, body):
        assert np.allclose(weights.sum(axis=1), 1)
    assert near[0, 1] > 0.4
    assert near[0, 2] < 0.001
    assert body[0, 2] > 0.2
    assert body[0, 3] < 1e-6
    assert Neighbours(np.zeros((0, 3))).body(np.zeros((0, 5))).shape == (0, 5)


def test_mixture_prefers_the_expert_that_did_best() -> None:
    weights = mix(np.array([[0.02, 0.3], [0.2, 0.3], [0.2, 0.01]]) ** 2)
    assert np.allclose(weights.sum(axis=0), 1)
    assert weights[0, 0] > 0.95
    assert weights[2, 1] > 0.95


def test_free_fall_is_exact_for_what_falls_and_bounces_off_the_floor() -> None:
    times, speed = np.arange(4) / 15, np.array([2.0, 0.5, 1.0])
    ages = times - times[-1]
    places = np.array([0.0, 0.0, 1.0]) + ages[:, None] * speed + ages[:, None] ** 2 / 2 * GRAVITY
    history, horizons = History(times, places[:, None]), np.array([0.1, 0.3])
    true = horizons[:, None] * speed + horizons[:, None] ** 2 / 2 * GRAVITY
    assert np.allclose(free_fall(history, horizons)[:, 0], true)
    low = 1.0 + float(true[1, 2]) + 0.1
    bounced = free_fall(history, horizons, low)[:, 0]
    assert np.allclose(bounced[0], true[0])
    down = np.sqrt(1.0 + 2 * 9.81 * (1.0 - low))  # its speed when it gets there
    since = 0.3 - (1.0 + down) / 9.81
    assert np.isclose(1.0 + bounced[1, 2], low + BOUNCE * down * since - 9.81 * since**2 / 2)
    assert np.allclose(bounced[1, :2], true[1, :2])
    later = free_fall(history, np.array([2.0]), low)[0, 0]
    assert np.isclose(1.0 + later[2], low)
