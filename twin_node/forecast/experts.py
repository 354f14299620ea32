"""Motion experts: where nodes will be after a horizon, each a pure function over a batch of nodes.

All take a `History` and horizons [H] in seconds after its last sample, and give displacements [H, M, 3] in metres from
the last position. No single one is right for human motion, so their forecasts are mixed by how well each did (`mix`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from twin_node.forecast.neighbours import Neighbours
from twin_node.scene import Float64


class Between(NamedTuple):
    """A time between two samples."""

    before: int
    after: int
    share: float
    """Of the way from the one to the other."""


@dataclass(frozen=True)
class History:
    """Where nodes have been."""

    times: Float64
    """[T] s, strictly increasing, the last is now."""
    positions: Float64
    """[T, M, 3] m; a node younger than a sample stands at its first position there."""

    def at(self, time: float) -> Float64:
        """Positions [M, 3] at a time, interpolated; the first or last ones outside the samples."""
        found = self.between(time)
        at: Float64 = (1 - found.share) * self.positions[found.before] + found.share * self.positions[found.after]
        return at

    def between(self, time: float) -> Between:
        """Which samples a time lies between; the first or last ones outside."""
        last = len(self.times) - 1
        if last < 1:
            return Between(last, last, 0.0)
        after = min(max(int(np.searchsorted(self.times, time)), 1), last)
        share = float((time - self.times[after - 1]) / (self.times[after] - self.times[after - 1]))
        return Between(after - 1, after, min(max(share, 0.0), 1.0))

    def at_all(self, times: Float64) -> Float64:
        """The same [n, M, 3] at `times` [n]."""
        before, after, shares = (np.array(column) for column in zip(*map(self.between, times.tolist()), strict=True))
        shares = shares[:, None, None]
        at: Float64 = (1 - shares) * self.positions[before] + shares * self.positions[after]
        return at

    @cached_property
    def line(self) -> Float64:
        """[1, M, 3] velocities of the last `LINE_S`, m/s."""
        return self._polynomial(1, LINE_S)

    @cached_property
    def parabola(self) -> Float64:
        """[2, M, 3] velocities and halves of accelerations of the last `PARABOLA_S`, m/s and m/s^2."""
        return self._polynomial(2, PARABOLA_S)

    @cached_property
    def falling(self) -> Float64:
        """[M, 3] velocities now, m/s, if all of the last `LINE_S` was free fall."""
        ages = self.times - self.times[-1]
        ages = ages[-self._used(1, LINE_S) :]
        squares = float(ages @ ages)
        # the line through half g t^2 falls behind by so much: its velocity is that of the middle of its span
        behind = float((ages**3).sum()) / 2 / squares if squares > 0 else 0.0
        velocities: Float64 = self.line[0] - behind * GRAVITY
        return velocities

    def take_fits(self, line: Float64, parabola: Float64, falling: Float64) -> None:
        """Takes over its fits from where they were made together with more (`outlook`)."""
        vars(self).update(line=line, parabola=parabola, falling=falling)

    def _used(self, degree: int, span: float) -> int:
        """Samples of the last `span` seconds, and one more where they fill less of it than `FILLED`."""
        ages = self.times - self.times[-1]
        used = min(max(int(np.count_nonzero(ages >= -span - 1e-6)), degree + 1), len(ages))
        return used + 1 if used < len(ages) and -ages[-used] < FILLED * span else used

    def _polynomial(self, degree: int, span: float) -> Float64:
        """Coefficients [degree, M, 3] of the least-squares polynomial in time about the last position.

        Missing coefficients of too few samples are 0.
        """
        ages, used = self.times - self.times[-1], self._used(degree, span)
        fitted = min(degree, used - 1)
        design = np.vander(ages[-used:], fitted + 1, increasing=True)[:, 1:]
        moved = self.positions[-used:] - self.positions[-1]
        coefficients = np.zeros((degree, *moved.shape[1:]))
        shares = np.linalg.solve(design.T @ design, design.T)  # of every sample in every coefficient
        coefficients[:fitted] = (shares @ moved.reshape(used, -1)).reshape(fitted, *moved.shape[1:])
        return coefficients


GRAVITY = np.array([0.0, 0.0, -9.81])
"""m/s^2, in `base_link`, whose z points up."""
BOUNCE = 0.5
"""Share of its speed that a thing keeps when it bounces: 0.3 for a full carton, 0.8 for a tennis ball."""
_HIGH = 1e3
"""So far above its floor (m) nothing gets within a horizon."""
LINE_S, PARABOLA_S = 0.07, 0.15
"""Spans that velocities, and accelerations, are fitted to, s: two and four steps of a camera at 30 Hz."""
FILLED = 0.85
"""Share of its span that the samples of a fit must fill: close stamps magnify their errors without bound."""

Expert = Callable[[History, Float64], Float64]


def persistence(history: History, horizons: Float64) -> Float64:
    """Nothing moves on."""
    return np.zeros((len(horizons), *history.positions.shape[1:]))


def constant_velocity(history: History, horizons: Float64) -> Float64:
    """Straight on at the velocity of the last `LINE_S` (least squares)."""
    straight: Float64 = np.asarray(horizons)[:, None, None] * history.line
    return straight


RELAXATION_S = 0.15
"""Time constant in which a damped velocity decays, s."""


def damped(history: History, horizons: Float64) -> Float64:
    """The velocity decays with a time constant `RELAXATION_S`: limbs turn round within half a second."""
    return constant_velocity(history, damped_times(np.asarray(horizons)))


def damped_times(horizons: Float64) -> Float64:
    """[H] s in which what does not slow down gets as far as what does in `horizons` [H] (s)."""
    travelled: Float64 = RELAXATION_S * (1 - np.exp(-horizons / RELAXATION_S))
    return travelled


def constant_acceleration(history: History, horizons: Float64) -> Float64:
    """A parabola through the last `PARABOLA_S` (least squares)."""
    time = np.asarray(horizons)[:, None, None]
    curved: Float64 = time * history.parabola[0] + time**2 * history.parabola[1]
    return curved


def free_fall(history: History, horizons: Float64, floors: float | Float64 = -np.inf) -> Float64:
    """What was thrown or dropped: the velocity of the last `LINE_S` and gravity, no drag.

    What comes down to its height of `floors` ([M] or one for all, m) bounces off it, once: then it stays there.
    """
    time = np.asarray(horizons)[:, None, None]
    fallen: Float64 = time * history.falling + time**2 / 2 * GRAVITY
    above = np.minimum(np.maximum(history.positions[-1][:, 2] - floors, 0), _HIGH)
    impact = np.sqrt(history.falling[:, 2] ** 2 - 2 * GRAVITY[2] * above)  # its speed then, m/s
    since = time[..., 0] + (history.falling[:, 2] + impact) / GRAVITY[2]
    bounced = np.maximum(BOUNCE * impact * since + since**2 / 2 * GRAVITY[2], 0) - above
    fallen[..., 2] = np.where(since > 0, bounced, fallen[..., 2])
    return fallen


EXPERTS: tuple[Expert, ...] = (persistence, constant_velocity, damped, constant_acceleration)
"""The experts of motion by will that are without memory, in the order of their weights."""
EXPERT_NAMES = ("persistence", "constant_velocity", "damped", "constant_acceleration", "autoregression", "free_fall")
"""All experts in the order of their weights."""


LAGS = 5
"""Steps that the autoregression looks back on."""
LAG_S = 0.033
"""Length of a step of the autoregression, s: five of them span most of a horizon of 200 ms."""
FEATURES = 3 * LAGS
"""Features of the autoregression: a node's own steps and their averages over its `Neighbours`."""
LEAST_GRAM = 1e-4
"""What its normal equations begin with, and never forget, m^2: without evidence its weights are 0."""
LEARNT_S = 3.3
"""Time constant in which it forgets, s; at 30 Hz a factor of 0.99 per sample."""


def steps(history: History) -> Float64:
    """The last `LAGS` displacements [M, 3, LAGS] over `LAG_S` each, newest first, interpolated in time."""
    wanted = history.times[-1] - LAG_S * np.arange(LAGS + 1)
    at = history.at_all(wanted)
    newest_first: Float64 = np.moveaxis(at[:-1] - at[1:], 0, -1)
    return newest_first


def autoregression_features(history: History, around: Neighbours) -> Float64:
    """[M, 3, FEATURES] what the autoregression sees of each node along each axis."""
    own = steps(history)
    flat = own.reshape(len(own), 3 * LAGS)
    near, body = around.near(flat).reshape(own.shape), around.body(flat).reshape(own.shape)
    return np.concatenate([own, near, body], axis=-1)


class Autoregression:
    """Displacement as a linear function of a node's and its neighbours' last steps, fitted online to what came true.

    Recursive least squares with forgetting, its weights shared by all nodes and axes, so that it turns with the frame
    and learns from every node; fitted at `KNOTS` shares of the horizon and interpolated between them.
    """

    def __init__(self) -> None:
        self.gram = np.tile(np.eye(FEATURES) * LEAST_GRAM, (len(KNOTS), 1, 1))
        """[K, F, F] of the normal equations, m^2."""
        self.moment = np.zeros((len(KNOTS), FEATURES))
        """[K, F] their right sides, m^2."""
        self._solved: Float64 | None = None

    def forecast(self, features: Float64, shares: Float64) -> Float64:
        """Displacements [H, M, 3] of nodes with `autoregression_features` [M, 3, F], at shares [H] of the horizon."""
        flat: Float64 = self.weights(shares) @ features.reshape(-1, FEATURES).T
        return flat.reshape(len(shares), len(features), 3)

    def weights(self, shares: Float64) -> Float64:
        """[H, F] of the features, at shares [H] of the horizon."""
        return np.asarray(_interpolation(tuple(shares.tolist())) @ self._solution())

    def _solution(self) -> Float64:
        """[K, F] as of what was learnt last."""
        if self._solved is None:
            solved = np.linalg.solve(self.gram, self.moment[..., None])[..., 0]
            self._solved = np.asarray(solved, np.float64)
        return self._solved

    def learn(self, knot: int, features: Float64, came_true: Float64, elapsed_s: float) -> None:
        """Takes in what became of nodes by a knot: their features then [M, 3, F] and displacement since [M, 3].

        `elapsed_s`: time since this knot was last learnt about.
        """
        if len(features) == 0:
            return
        self.outdate()
        kept = np.exp(-elapsed_s / LEARNT_S)
        flat = features.reshape(-1, FEATURES)
        weight = elapsed_s / LAG_S / len(features)
        least = (1 - kept) * LEAST_GRAM * np.eye(FEATURES)
        self.gram[knot] = kept * self.gram[knot] + weight * flat.T @ flat + least
        self.moment[knot] = kept * self.moment[knot] + weight * flat.T @ came_true.reshape(-1)

    def outdate(self) -> None:
        """Has the weights solved for anew: the normal equations have changed."""
        self._solved = None


KNOTS = (0.25, 0.5, 0.75, 1.0)
"""Shares of the horizon that the autoregression is fitted at."""


@lru_cache(maxsize=16)
def _interpolation(shares: tuple[float, ...]) -> Float64:
    """[H, K] weights of values at `KNOTS` that interpolate linearly at H shares, and extrapolate at the end: 0 at 0."""
    at, knots = np.array(shares), np.array([0.0, *KNOTS])
    after = np.clip(np.searchsorted(knots, at), 1, len(knots) - 1)
    share = (at - knots[after - 1]) / (knots[after] - knots[after - 1])
    weights = np.zeros((len(at), len(knots)))
    rows = np.arange(len(at))
    weights[rows, after - 1], weights[rows, after] = 1 - share, share
    return weights[:, 1:]


SHARPNESS = 0.15
"""Relative difference of mean square errors at which an expert's weight falls to 1/e."""


def mix(squared_errors: Float64) -> Float64:
    """Weights [E, M] of experts from their recent mean square errors [E, M] (m^2): sharper the smaller the best."""
    best = squared_errors.min(axis=0)
    weights = np.exp(-(squared_errors - best) / (SHARPNESS * best + INDIFFERENCE**2))
    normalised: Float64 = weights / weights.sum(axis=0)
    return normalised


INDIFFERENCE = 0.003
"""Errors below this do not tell experts apart, m: what tracking noise leaves."""
