"""Tracks: where each part has been, what was forecast for it, and how wrong that was."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin_node.forecast.experts import EXPERTS, Autoregression, History, mix, steps
from twin_node.scene import Float64

REACH = 0.12
"""A part continues the track whose forecast place is at most this far off, m (one and a half parts)."""
KIN = 0.3
"""A new part takes over the record of errors of a part this near, m: a hull changes shape at its rims."""
KEPT = 32
"""Samples kept per track: half a second at 60 Hz."""

_EXPERTS = len(EXPERTS) + 1


@dataclass
class Tracks:
    """Tracks of M parts over the last T samples; arrays are re-indexed as parts take over from parts."""

    times: Float64 = field(default_factory=lambda: np.zeros(0))
    """[T] s."""
    positions: Float64 = field(default_factory=lambda: np.zeros((0, 0, 3)))
    """[T, M, 3] m."""
    velocities: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    """[M, 3] m/s."""
    ages: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """[M] samples that the record of errors goes back."""
    born: Float64 = field(default_factory=lambda: np.zeros(0))
    """[M] s when each path began."""
    forecasts: Float64 = field(default_factory=lambda: np.zeros((0, _EXPERTS, 0, 3)))
    """[T, E, M, 3] places each expert forecast for `horizon_s` after each sample, m."""
    errors: Float64 = field(default_factory=lambda: np.zeros((_EXPERTS, 0)))
    """[E, M] recent errors of the experts, m."""
    own_errors: Float64 = field(default_factory=lambda: np.zeros(0))
    """[M] recent error of the mixture, m: quick to grow, slow to shrink."""
    judgements: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """[M] forecasts that have entered the records of errors."""
    valid_at: Float64 = field(default_factory=lambda: np.zeros(0))
    """[T] s that each sample's forecasts were made for."""
    autoregression: Autoregression = field(default_factory=lambda: Autoregression(NOMINAL_HORIZON_S))

    @property
    def history(self) -> History:
        """The tracks as the experts see them."""
        return History(self.times, self.positions)

    @property
    def ages_s(self) -> Float64:
        """[M] time that each part's record of errors goes back, s."""
        if len(self.times) == 0:
            return np.zeros(len(self.ages))
        ages: Float64 = self.times[-1] - self.times[np.maximum(len(self.times) - 1 - self.ages, 0)]
        return ages

    @property
    def mean_weights(self) -> Float64:
        """[E] weights of the experts, averaged over the parts."""
        return mix(self.errors).mean(axis=1) if self.errors.size else np.zeros(len(EXPERTS) + 1)

    def advance(self, time: float, centers: Float64, velocities: Float64, horizon_s: float) -> None:
        """Continues the tracks into parts at `centers` [M', 3] that move at `velocities` [M', 3], at `time` (s).

        Every expert then forecasts them for `horizon_s` from now; what it gets wrong shows when that time comes.
        """
        step = time - self.times[-1] if len(self.times) else 0.0
        places = centers - velocities * step
        shift = self._inherit(time, self._parents(places), self._parents(places, KIN), centers, velocities * step)
        self.positions = np.concatenate([self.positions + shift, centers[None]])[-KEPT:]
        self.times = np.append(self.times, time)[-KEPT:]
        made = len(self.times) - 1  # forecasts of the times before now, row for row
        self.forecasts = (self.forecasts + shift)[len(self.forecasts) - made :]
        self.valid_at = self.valid_at[len(self.valid_at) - made :]
        self.velocities = velocities
        self._learn_from_due_forecasts()
        self._issue(horizon_s)

    def displacements(self, horizons: Float64) -> Float64:
        """The mixture's displacements [H, M, 3] after horizons [H] in seconds."""
        weights = mix(self.errors)
        single = [expert(self.history, horizons) for expert in (*EXPERTS, self.autoregression.forecast)]
        mixed: Float64 = np.einsum("em,ehmc->hmc", weights, np.stack(single))
        return mixed

    def _parents(self, places: Float64, reach: float = REACH) -> NDArray[np.int64]:
        """Track [n] that each place continues; M (one past the last) for none."""
        count = len(self.velocities)
        if count == 0 or len(places) == 0:
            return np.full(len(places), count, np.int64)
        found = cKDTree(self.positions[-1]).query(places, distance_upper_bound=reach)[1]
        return np.asarray(found, dtype=np.int64)

    def _inherit(
        self, time: float, parents: NDArray[np.int64], kin: NDArray[np.int64], centers: Float64, moved: Float64
    ) -> Float64:
        """Re-indexes paths by parent and records by kin; gives the shift [M', 3] from the parents' paths to the parts.

        A part is a cell of a lattice, not a body: its path is its parent's, moved so that the last step is `moved`.
        """
        born = parents == len(self.velocities)
        self.positions = _taken(self.positions, parents, 1, 0.0)
        self.forecasts = _taken(self.forecasts, parents, 2, np.nan)
        self.errors = _taken(self.errors, kin, 1, UNTRIED_ERROR)
        self.own_errors = _taken(self.own_errors, kin, 0, UNTRIED_ERROR)
        self.judgements = np.append(self.judgements, 0)[kin]
        self.ages = np.where(kin == len(self.velocities), 0, np.append(self.ages, 0)[kin] + 1)
        self.born = _taken(self.born, parents, 0, time)
        self.positions[:, born] = (centers - moved)[born]
        return centers - moved - self.positions[-1] if len(self.positions) else np.zeros(centers.shape)

    def _issue(self, horizon_s: float) -> None:
        """Has every expert forecast the place at the horizon."""
        at = np.array([horizon_s])
        single = [expert(self.history, at)[0] for expert in (*EXPERTS, self.autoregression.forecast)]
        places = self.positions[-1] + np.stack(single)
        self.valid_at = np.append(self.valid_at, self.times[-1] + horizon_s)
        self.forecasts = np.concatenate([self.forecasts, places[None]])

    def _learn_from_due_forecasts(self) -> None:
        """Judges the forecasts that were made for about now, and teaches the autoregression."""
        if len(self.times) < 2:
            return
        due = int(np.abs(self.valid_at - self.times[-1]).argmin())
        if abs(self.valid_at[due] - self.times[-1]) > 0.6 * (self.times[-1] - self.times[-2]):
            return
        wrong = np.linalg.norm(self.forecasts[due] - self.positions[-1], axis=-1)
        judged = np.isfinite(wrong).all(axis=0)
        first = 1 / (1 + self.judgements)  # an average of what there is, until there is more than the records hold
        self.judgements = self.judgements + judged
        rate = np.maximum(0.15, first)
        self.errors = np.where(judged, self.errors + rate * (wrong - self.errors), self.errors)
        mixed = np.einsum("em,emc->mc", mix(self.errors), self.forecasts[due])
        own = np.linalg.norm(mixed - self.positions[-1], axis=-1)
        rate = np.maximum(np.where(own > self.own_errors, 0.5, 0.08), first)
        self.own_errors = np.where(judged, self.own_errors + rate * (own - self.own_errors), self.own_errors)
        then = History(self.times[: due + 1], self.positions[: due + 1][:, judged])
        came_true = (self.positions[-1] - self.positions[due])[judged]
        self.autoregression.learn(steps(then), came_true, self.times[-1] - self.times[due])


def _taken(values: Float64, rows: NDArray[np.int64], axis: int, missing: float) -> Float64:
    """`values` re-indexed along `axis`; one row past the last gives `missing`."""
    shape = list(values.shape)
    shape[axis] = 1
    return np.take(np.concatenate([values, np.full(shape, missing)], axis=axis), rows, axis=axis)


NOMINAL_HORIZON_S = 0.2
"""Horizon that the autoregression is fitted for, s; others are reached in proportion."""
UNTRIED_ERROR = 0.1
"""Error ascribed to experts that have not been judged yet, m: about their mean on human motion at 200 ms."""
