"""How far from its forecast place a node may be: a bound calibrated online on what came true."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from twin_node.forecast.error_scale import Came, Scale, regress
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.past_errors import PastErrors
from twin_node.ranges import NOT_NEGATIVE, Range, check_ranges
from twin_node.scene import Bool, Float64

PERSON_SPEED = 1.6
"""Speed of approach of a person, m/s (ISO 13855)."""

MEMORY_S = 2.0
"""Time constant in which old errors lose their say, s: a gesture or two."""
FIRST_FACTOR = 0.55
"""Common factor before there is a record: parts of a hull of silhouettes hold more than what moves."""
LEAST_FACTOR, MOST_FACTOR = 0.5, 3.0
"""Of the common factor. What images show tells nothing of sides that no camera sees: while something goes on in one way
for long, the factor would shrink until slivers of these are missed, and no coverage that is seen would say so."""
RELIEF = 2.0
"""Time constant in which the factor returns to its level when nothing is missed, in horizons."""
LARGEST_RADIUS = 0.8
"""No radius exceeds this at the last horizon, m: 99 % of human motion stays within half of it in 200 ms."""

CUES = 7
"""Cues of a node's error scale, `cues`: one constant and six logarithms of lengths."""


@dataclass(frozen=True)
class BoundParameters:
    """Target and manners of the calibrated bound."""

    coverage: float = 0.99
    """Share of the moving space, and of the nodes, that the forecast made for it must hold."""
    acceleration: float = 6.0
    """Largest acceleration taken into account before there is a record, m/s^2: a hand starting a reach, or gravity."""
    correction: float = 0.02
    """How fast the miss rate aimed at follows what was missed, per second (Gibbs and Candes 2021)."""
    follow: float = 2.0
    """Relative growth of the common factor's level per unit of coverage missed in the images, per horizon; where
    nothing is missed at all, that is a shrinkage by 2 % per horizon."""
    surprise: float = 2.5
    """A miss asks at once for a factor so much larger, relative and per unit of coverage missed, than the one that the
    forecast was made with."""

    def __post_init__(self) -> None:
        """Raises `ForecastError` for a number that is none of its kind."""
        check_ranges(
            self,
            ForecastError,
            "forecast: bound.",
            coverage=Range(0.5, 0.9999),
            acceleration=NOT_NEGATIVE,
            correction=NOT_NEGATIVE,
            follow=NOT_NEGATIVE,
            surprise=NOT_NEGATIVE,
        )


@dataclass(frozen=True)
class CueLengths:
    """What the errors of M nodes are foreseen from: lengths over one horizon, m, [M] each."""

    spread: Float64
    """Median distance of the experts from the mixture: a single wild one does not count."""
    way: Float64
    """Travelled at constant velocity."""
    acceleration: Float64
    """How far constant acceleration and constant velocity are apart."""
    body_way: Float64
    """Root mean square of `way` over the body."""
    body_acceleration: Float64
    """The same of `acceleration`."""
    body_error: Float64
    """The same of the recent errors."""


def cues(lengths: CueLengths) -> Float64:
    """Cues [M, CUES] of the error scale of nodes."""
    columns = np.stack([getattr(lengths, column.name) for column in fields(lengths)], axis=1)
    return np.concatenate([np.ones((len(columns), 1)), np.log(columns + LEAST)], axis=1)


LEAST = 0.05
"""Lengths well below this do not tell errors apart, m: a voxel or two, and the noise of tracking."""


class Expected(NamedTuple):
    """What is expected of the errors of M nodes."""

    scales: Float64
    """[M] m at the last horizon: upper ones, not means."""
    spread: Float64
    """[M] m, how far the experts are apart."""


class Bound:
    """Radius = a node's own expected error x a quantile pooled over all nodes.

    The expected error is a regression of the logarithm of past errors on `cues`, fitted online to their upper part
    (asymmetric least squares, Newey and Powell 1987). The quantile of errors over expected errors is taken over the
    last seconds; its level follows the misses (adaptive conformal inference, Gibbs and Candes 2021).
    """

    def __init__(self, parameters: BoundParameters | None = None) -> None:
        self.parameters = parameters or BoundParameters()
        self._scale = Scale.before_errors()
        self._past = PastErrors(CUES, MEMORY_S)
        self._miss_level = 1 - self.parameters.coverage
        self._seen_s = 0.0
        self.quantile = _FIRST_QUANTILE
        """Of errors over expected ones."""

    def observe(
        self, time: float, then: Float64, errors: Float64, radii: Float64, elapsed_s: float, grown: Bool | None = None
    ) -> None:
        """Takes in the errors [n] (m) at `time` (s) of nodes with cues `then` [n, CUES] and radii [n] when forecast.

        `elapsed_s`: time since the last observation. The radii are those that ought to have held the errors. `grown`
        [n] is False for forecasts of before something new began, or hardly after; True for all if not given. They count
        as missed, and tell nothing of errors to come.
        """
        if len(errors) == 0:
            return
        p = self.parameters
        missed = int(np.count_nonzero(errors > radii)) / len(errors)
        level = self._miss_level + p.correction * elapsed_s * ((1 - p.coverage) - missed)
        self._miss_level = min(max(level, 0.0), _MOST_LEVEL * (1 - p.coverage))
        self._seen_s += elapsed_s
        if grown is not None:
            then, errors, radii = then[grown], errors[grown], radii[grown]
        if len(errors):
            self._learn(time, then, errors, radii, elapsed_s)

    def _learn(self, time: float, then: Float64, errors: Float64, radii: Float64, elapsed_s: float) -> None:
        """Enters errors [n] of nodes with cues `then` [n, CUES] in the regression, and an even sample in the pool."""
        kept = float(np.exp(-elapsed_s / MEMORY_S))
        regress(self._scale, Came(then, np.log(errors + LEAST), kept, 2 * elapsed_s / _STEP_S / len(errors)))
        some = slice(None, None, -(-len(errors) // _SAMPLE))
        logs = np.log(np.clip(errors[some], 1e-6, _SURPRISE * radii[some]))
        self._past.enter(time, then[some], logs, elapsed_s)
        quantile = self._past.log_quantile(time, self._scale.slopes, 1 - self._miss_level)
        share = np.exp(-self._seen_s / _TRUSTED_S)
        self.quantile = np.exp(share * np.log(_FIRST_QUANTILE) + (1 - share) * quantile)

    def scales(self, now: Float64) -> Float64:
        """Expected errors [M] in metres at the last horizon, of nodes with cues [M, CUES]: upper ones, not means."""
        scales: Float64 = np.exp(now @ self._scale.slopes)
        return scales

    def expected(self, now: Float64) -> Expected:
        """What is expected of the errors of nodes with cues [M, CUES]."""
        return Expected(self.scales(now), np.exp(now[:, 1]) - LEAST)

    def radii(
        self, expected: Expected, ages: Float64, horizon_s: float, factor: float = 1.0, stale_s: float = 0.0
    ) -> Float64:
        """Radii [M] in metres at the horizon; `factor` multiplies what is calibrated, `stale_s` as `reachable` has it.

        Nodes whose record of `ages` [M] (s) is shorter than the horizon may be anywhere that they can reach, and no
        expert has shown to be right: their radius is at least a h^2 / 2 and the spread of the experts.
        """
        calibrated = factor * self.quantile * expected.scales
        reachable = self.reachable(horizon_s, stale_s) + expected.spread
        radii: Float64 = np.where(ages >= horizon_s, calibrated, np.maximum(calibrated, reachable))
        return np.minimum(radii, LARGEST_RADIUS)

    def reachable(self, horizon_s: float, stale_s: float = 0.0) -> float:
        """How far the largest acceleration takes a node from where its velocity of `stale_s` ago leads, m."""
        return self.parameters.acceleration * (horizon_s**2 / 2 + stale_s * horizon_s)


class CoverageControl:
    """A factor on all calibrated radii that keeps the coverage seen in the images at its target.

    What the cameras see to move is the truth here: it holds what the nodes' own errors cannot show, such as space that
    nobody saw. Adaptive conformal inference on a multiplicative scale: quick to grow with each missed share, slow to
    shrink while the target is kept. A miss asks for growth over the factor that the forecast was made with: that was a
    horizon ago, and what has grown since need not grow again for the same surprise.
    """

    def __init__(self, parameters: BoundParameters) -> None:
        self.parameters = parameters
        self.factor = self._level = FIRST_FACTOR
        self._covered: deque[float] = deque(maxlen=120)

    @property
    def coverage(self) -> float:
        """Mean share that the forecasts held over the last 120 judged image sets; NaN before the first."""
        return float(np.mean(self._covered)) if self._covered else float("nan")

    def observe(self, covered: float, steady: float | None, then: float, elapsed: float) -> None:
        """Takes in the share [0, 1] of now moving space that lay inside the forecast made for now.

        `steady` is that of the parts that began nothing new since, None if there were none: those that did are bounded
        by their reach, and larger radii for all others would not have held them. `then` is the factor the forecast was
        made with; `elapsed` is the time since the last observation in horizons.
        """
        p = self.parameters
        self._covered.append(covered)
        missed, elapsed = p.coverage - (p.coverage if steady is None else steady), min(elapsed, 1.0)
        self._level = self._clipped(self._level * np.exp(p.follow * missed * elapsed))
        needed = then * np.exp(p.surprise * missed) if missed > 0 else 0.0
        relieved = self._level + (self.factor - self._level) * np.exp(-elapsed / RELIEF)
        self.factor = self._clipped(max(self._level, relieved, needed))

    def _clipped(self, factor: float) -> float:
        return float(np.clip(factor, LEAST_FACTOR, MOST_FACTOR))


_STEP_S = 1 / 30
"""Errors of this much time count as one sample in the regression, s."""
_SAMPLE = 64
"""Most errors per time that enter the quantile: neighbouring nodes err together."""
_SURPRISE = 1.25
"""Errors enter the quantile as no more than so many times the radius that ought to have held them: what nobody could
foresee is met by the reachable set, and widens the bound for good only where it happens again."""
_MOST_LEVEL = 5.0
"""The miss level may rise to so many times the rate aimed at."""
_TRUSTED_S = 0.5
"""Time constant in which the quantile moves from its first value to that of the record, s."""
_FIRST_QUANTILE = 2.5
"""Quantile before there is a record: that of human motion at 99 % (measured: `bench forecast`)."""
