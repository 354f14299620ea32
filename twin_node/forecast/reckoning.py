"""What became of forecasts of nodes, by a knot: how far wrong they were, and the records that this enters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin_node.forecast.experts import KNOTS, History
from twin_node.forecast.kernel_requests import Between as BetweenRequest
from twin_node.forecast.kernel_requests import ReckonRequest
from twin_node.forecast.kernels import Kernels, kernels
from twin_node.forecast.records import FALL_S, RECORD_S, RISE_S, Records, Rows
from twin_node.forecast.turning import NARROWER, off_the_way
from twin_node.scene import Bool, Float64

STARTLED = 1.5
"""A node whose forecast is so many times further off than its bound at that time began something new: its record begins
anew, and until there is one, the reachable set bounds it. What was forecast before says nothing of the motion since."""
_GROWN = 0.5
"""Horizons after which errors of what began something new tell of those to come: sooner it is bounded by its reach, and
what it errs while nobody can know better would keep the bound of all wide for seconds."""
_TURN = 0.1
"""What went less astray did not turn back, m: a part is as long, and velocities are noisy."""


@dataclass
class Issued:
    """Forecasts of one time that wait for the truth, of M' nodes; arrays are contiguous."""

    time: float
    """s."""
    horizon_s: float
    rows: Rows
    """[M now] row of each node's ancestor among the nodes then; -1 for none."""
    features: Float64
    """[M', 3, F] of the autoregression."""
    places: Float64
    """[E, K, M', 3] displacements that the experts forecast at the knots, m."""
    mixed: Float64
    """[K, M', 3] those of the mixture."""
    cues: Float64
    """[M', C]."""
    radii: Float64
    """[M'] at the horizon, m."""
    turning: Bool
    """[M'] those that are held along all of their way."""
    factor: float
    """On the calibrated radii."""
    due: int = 0
    """The next knot to come true."""

    @cached_property
    def addresses(self) -> tuple[int, ...]:
        """Of the places, their mixture, radii and who turns: good for as long as this lives."""
        return tuple(array.ctypes.data for array in (self.places, self.mixed, self.radii, self.turning))

    @property
    def valid_at(self) -> float:
        """Time of that knot, s."""
        return self.time + KNOTS[self.due] * self.horizon_s


@dataclass(frozen=True)
class Manner:
    """How errors enter records."""

    elapsed_s: float
    """Since errors by this knot entered them last."""
    memory_s: float
    """Time constant of their mean, s."""
    turns: bool
    """Nodes that turn back are told from others, and judged by all of their way (`turning.whole_ways`)."""


@dataclass(frozen=True)
class Reckoned:
    """What became of the forecasts of n nodes that there are still."""

    rows: Rows
    """[n] among the nodes then."""
    moved: Float64
    """[n, 3] since then, m."""
    wrong: Float64
    """[n] how far from where the mixture led, or from its way, m."""
    grown: Bool
    """[n] nodes whose motion began long enough ago for this to tell of what is to come."""


def reckon(issued: Issued, history: History, records: Records, profile: Float64, manner: Manner) -> Reckoned:
    """What became of forecasts by the knot that is due, on the paths as they are known now.

    Changes the records, and the `profile` [K] of the mixture's mean errors (m) by each knot. Compiled; `reckon_plainly`
    where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return reckon_plainly(issued, history, records, profile, manner)
    return _reckon_by(compiled, issued, history, records, profile, manner)


def _reckon_by(
    compiled: Kernels, issued: Issued, history: History, records: Records, profile: Float64, manner: Manner
) -> Reckoned:
    count = len(issued.rows)
    found = Reckoned(np.empty(count, np.int64), np.empty((count, 3)), np.empty(count), np.empty(count, np.bool_))
    given = (np.ascontiguousarray(history.positions), np.ascontiguousarray(issued.rows))
    kept = (profile, records.squared, records.errors, records.began, records.turned, records.judged)
    results = (found.rows, found.moved, found.wrong, found.grown)
    left = compiled.reckon(
        ReckonRequest(
            *(count, len(issued.radii), len(issued.places), len(KNOTS), issued.due, manner.turns),
            *(BetweenRequest(*history.between(time)) for time in (issued.valid_at, issued.time)),
            *(array.ctypes.data for array in given),
            *issued.addresses,
            *(history.times[-1], issued.time, issued.factor, STARTLED, _GROWN * issued.horizon_s, _TURN, NARROWER),
            *(KNOTS[issued.due], np.exp(-manner.elapsed_s / manner.memory_s)),
            *(1 - np.exp(-manner.elapsed_s / constant) for constant in (RECORD_S, RISE_S, FALL_S)),
            *(array.ctypes.data for array in (*kept, *results)),
        )
    )
    return Reckoned(found.rows[:left], found.moved[:left], found.wrong[:left], found.grown[:left])


def reckon_plainly(issued: Issued, history: History, records: Records, profile: Float64, manner: Manner) -> Reckoned:
    """What `reckon` does."""
    knot, now = issued.due, float(history.times[-1])
    known = np.flatnonzero(issued.rows >= 0)
    rows = issued.rows[known]
    moved = (history.at(issued.valid_at) - history.at(issued.time))[known]
    wrong = _errors(issued, known, moved, records, profile, now) if manner.turns else _distances(issued, rows, moved)
    if len(wrong):
        kept = np.exp(-manner.elapsed_s / manner.memory_s)
        profile[knot] = kept * profile[knot] + (1 - kept) * wrong.mean()
    single = np.linalg.norm(issued.places[:, knot, rows] - moved, axis=-1)
    records.weigh(known, single / KNOTS[knot], manner.elapsed_s)
    expected = issued.radii[rows] * profile[knot] / profile[-1]
    known_s = issued.time - np.maximum(records.began, records.turned)[known]
    knew, grown = known_s >= 0, known_s >= _GROWN * issued.horizon_s
    startled = known[wrong > STARTLED * expected]
    records.began[startled], records.judged[startled] = now, 0
    if knot == len(KNOTS) - 1:
        records.enter(known[knew], wrong[knew], manner.elapsed_s)
    return Reckoned(rows, moved, wrong, grown)


def _distances(issued: Issued, rows: Rows, moved: Float64) -> Float64:
    """[n] how far nodes that have `moved` [n, 3] are from where the mixture led those in `rows` [n], m."""
    distances: Float64 = np.linalg.norm(issued.mixed[issued.due, rows] - moved, axis=-1)
    return distances


def _errors(issued: Issued, known: Rows, moved: Float64, records: Records, profile: Float64, now: float) -> Float64:
    """Errors [n] in metres: the nodes `known` [n] have `moved` [n, 3].

    Takes note of those that have turned back; those that were held along all of their way err by their distance from
    it, as a share of its radius.
    """
    rows, knot = issued.rows[known], issued.due
    ahead, wrong = issued.mixed[knot, rows], _distances(issued, rows, moved)
    expected = issued.radii[rows] * profile[knot] / profile[-1]
    aside = off_the_way(ahead, moved) / NARROWER
    is_back = ((moved * ahead).sum(axis=-1) < 0) & (wrong > np.maximum(issued.factor * expected, _TURN))
    records.turned[known[is_back & (aside <= expected)]] = now
    return np.where(issued.turning[rows], np.minimum(wrong, aside), wrong)
