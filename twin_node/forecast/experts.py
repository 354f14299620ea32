"""Motion experts: where nodes will be after a horizon, each a pure function over a batch of nodes.

All take a `History` and horizons [H] in seconds after its last sample, and give displacements [H, M, 3] in metres from
the last position. No single one is right for human motion (measured: `docs/`), so their forecasts are mixed by how well
each did (`mix`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin_node.scene import Float64


@dataclass(frozen=True)
class History:
    """Where nodes have been."""

    times: Float64
    """[T] s, strictly increasing, the last is now."""
    positions: Float64
    """[T, M, 3] m; a node younger than a sample stands at its first position there."""


Expert = Callable[[History, Float64], Float64]


def persistence(history: History, horizons: Float64) -> Float64:
    """Nothing moves on."""
    return np.zeros((len(horizons), *history.positions.shape[1:]))


def constant_velocity(history: History, horizons: Float64) -> Float64:
    """Straight on at the velocity of the last 70 ms (least squares)."""
    return _polynomial(history, horizons, degree=1, span=0.07)


def damped(history: History, horizons: Float64, relaxation: float = 0.15) -> Float64:
    """The velocity decays with a time constant `relaxation` (s): limbs turn round within half a second."""
    travelled = relaxation * (1 - np.exp(-np.asarray(horizons) / relaxation))
    return constant_velocity(history, travelled)


def constant_acceleration(history: History, horizons: Float64) -> Float64:
    """A parabola through the last 150 ms (least squares)."""
    return _polynomial(history, horizons, degree=2, span=0.15)


def _polynomial(history: History, horizons: Float64, degree: int, span: float) -> Float64:
    """Extrapolates the least-squares polynomial in time through the samples of the last `span` seconds."""
    ages = history.times - history.times[-1]
    used = max(int(np.count_nonzero(ages >= -span - 1e-6)), degree + 1)
    used = min(used, len(ages))
    degree = min(degree, used - 1)
    design = np.vander(ages[-used:], degree + 1, increasing=True)[:, 1:]
    moved = history.positions[-used:] - history.positions[-1]
    coefficients = np.linalg.pinv(design) @ moved.reshape(used, -1)
    powers = np.vander(np.asarray(horizons), degree + 1, increasing=True)[:, 1:]
    forecast: Float64 = (powers @ coefficients).reshape(len(powers), *moved.shape[1:])
    return forecast


LAGS = 6
"""Steps that the autoregression looks back on."""
LAG_S = 0.033
"""Length of a step of the autoregression, s: six of them span a horizon of 200 ms."""


class Autoregression:
    """Displacement over a horizon as a linear function of the last `LAGS` steps, fitted online to what came true.

    Recursive least squares with forgetting, its weights shared by all nodes and axes. Fitted for one horizon;
    displacements at others are taken in proportion to their length.
    """

    def __init__(self, horizon_s: float, forgetting: float = 0.98) -> None:
        self.horizon_s = horizon_s
        self._forgetting = forgetting
        self._gram = np.eye(LAGS) * 1e-4
        self._moment = np.zeros(LAGS)

    def forecast(self, history: History, horizons: Float64) -> Float64:
        """Displacements [H, M, 3]."""
        displacement = steps(history) @ np.linalg.solve(self._gram, self._moment)
        forecast: Float64 = displacement[None] * (np.asarray(horizons) / self.horizon_s)[:, None, None]
        return forecast

    def learn(self, past_steps: Float64, came_true: Float64, elapsed_s: float) -> None:
        """Takes in what became of nodes: `steps` then [M, 3, LAGS], displacement since [M, 3] in `elapsed_s`."""
        features = past_steps.reshape(-1, LAGS)
        target = came_true.reshape(-1) * (self.horizon_s / elapsed_s)
        self._gram = self._forgetting * self._gram + features.T @ features + np.eye(LAGS) * 1e-7
        self._moment = self._forgetting * self._moment + features.T @ target


def steps(history: History) -> Float64:
    """The last `LAGS` displacements [M, 3, LAGS] over `LAG_S` each, newest first, interpolated in time."""
    wanted = history.times[-1] - LAG_S * np.arange(LAGS + 1)
    after = np.clip(np.searchsorted(history.times, wanted), 1, max(len(history.times) - 1, 1))
    if len(history.times) < 2:
        return np.zeros((*history.positions.shape[1:], LAGS))
    before = after - 1
    share = (wanted - history.times[before]) / (history.times[after] - history.times[before])
    share = np.clip(share, 0, 1)[:, None, None]
    at = (1 - share) * history.positions[before] + share * history.positions[after]
    newest_first: Float64 = np.moveaxis(at[:-1] - at[1:], 0, -1)
    return newest_first


EXPERTS: tuple[Expert, ...] = (persistence, constant_velocity, damped, constant_acceleration)
"""The experts without memory, in the order of their weights; the autoregression comes last."""


def mix(errors: Float64, sharpness: float = 0.15) -> Float64:
    """Weights [E, M] of experts from their recent errors [E, M] (m): sharper the smaller the best one's error."""
    best = errors.min(axis=0)
    weights = np.exp(-(errors - best) / (sharpness * best + 1e-3))
    normalised: Float64 = weights / weights.sum(axis=0)
    return normalised
