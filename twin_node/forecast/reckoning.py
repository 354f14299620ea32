"""What became of forecasts of nodes, by their knots: how far wrong they were, and the records that this enters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin_node.forecast.experts import KNOTS, LAG_S, LEARNT_S, LEAST_GRAM, Autoregression, History
from twin_node.forecast.kernels import Kernels, kernels
from twin_node.forecast.part_requests import DueForecast, ReckonRequest
from twin_node.forecast.records import FALL_S, RECORD_S, RISE_S, Records, Rows
from twin_node.forecast.turning import NARROWER, off_the_way
from twin_node.native_library import address_of, addresses_of
from twin_node.scene import Bool, Float64

STARTLED = 1.5
"""A node whose forecast is so many times further off than its bound at that time began something new: its record begins
anew, and until there is one, the reachable set bounds it. What was forecast before says nothing of the motion since."""
_GROWN = 0.5
"""Horizons after which errors of what began something new tell of those to come: sooner it is bounded by its reach, and
what it errs while nobody can know better would keep the bound of all wide for seconds."""
_LEARNT_FROM = 256
"""Most nodes per time that the autoregression learns from: its few weights are shared by all."""
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
    def addresses(self) -> list[int | None]:
        """Of the features, the places, their mixture, radii and who turns: good for as long as this lives."""
        return addresses_of(self.features, self.places, self.mixed, self.radii, self.turning)

    def valid_at(self, knot: int) -> float:
        """Time of a knot, s."""
        return self.time + KNOTS[knot] * self.horizon_s


@dataclass(frozen=True)
class Due:
    """Forecasts for a time that has come."""

    issued: Issued
    knot: int
    elapsed_s: float
    """Since errors by this knot were reckoned last."""


@dataclass(frozen=True)
class Ledger:
    """What errors enter, in place."""

    records: Records
    profile: Float64
    """[K] mean errors of the mixture by each knot, m."""
    autoregression: Autoregression


@dataclass(frozen=True)
class Manner:
    """How they enter it."""

    memory_s: float
    """Time constant of the profile, s."""
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


def reckon(due: Sequence[Due], history: History, ledger: Ledger, manner: Manner) -> list[Reckoned]:
    """What became of forecasts whose time has come, one after the other, on the paths as they are known now.

    Changes the ledger. Compiled; `reckon_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return reckon_reference(due, history, ledger, manner)
    return _reckon_by(compiled, due, history, ledger, manner)


def _reckon_by(
    compiled: Kernels, due: Sequence[Due], history: History, ledger: Ledger, manner: Manner
) -> list[Reckoned]:
    count, records, learning = history.positions.shape[1], ledger.records, ledger.autoregression
    results = (
        np.empty((len(due), count), np.int64),
        np.empty((len(due), count, 3)),
        np.empty((len(due), count)),
        np.empty((len(due), count), np.bool_),
    )
    left = np.zeros(len(due), np.int64)
    asked = (DueForecast * len(due))(*(_asked(one) for one in due))
    kept = (ledger.profile, records.squared, records.errors, records.began, records.turned, records.judged)
    times, positions = (np.ascontiguousarray(array, np.float64) for array in (history.times, history.positions))
    compiled.run(
        ReckonRequest(
            *(count, len(history.times), len(due), len(records.squared), *learning.moment.shape),
            *(manner.turns, _LEARNT_FROM),
            *(STARTLED, _TURN, NARROWER, LEAST_GRAM),
            *(manner.memory_s, RECORD_S, RISE_S, FALL_S, LEARNT_S, LAG_S),
            *addresses_of(times, positions, *kept, learning.gram, learning.moment, *results, left),
            asked,
        )
    )
    learning.outdate()
    rows, moved, wrong, grown = results
    return [
        Reckoned(rows[one, :several], moved[one, :several], wrong[one, :several], grown[one, :several])
        for one, several in enumerate(left.tolist())
    ]


def _asked(due: Due) -> DueForecast:
    issued, knot = due.issued, due.knot
    times = (issued.valid_at(knot), issued.time, issued.factor, _GROWN * issued.horizon_s, KNOTS[knot], due.elapsed_s)
    return DueForecast(len(issued.radii), knot, address_of(issued.rows), *issued.addresses, *times)


def reckon_reference(due: Sequence[Due], history: History, ledger: Ledger, manner: Manner) -> list[Reckoned]:
    """What `reckon` does."""
    found = []
    for one in due:
        found.append(_reckoned(one, history, ledger, manner))
        rows, moved = found[-1].rows, found[-1].moved
        some = slice(None, None, -(-len(rows) // _LEARNT_FROM) or 1)
        ledger.autoregression.learn(one.knot, one.issued.features[rows[some]], moved[some], one.elapsed_s)
    return found


def _reckoned(due: Due, history: History, ledger: Ledger, manner: Manner) -> Reckoned:
    """What became of one time's forecasts; enters them in the records and the profile."""
    issued, knot, records, profile = due.issued, due.knot, ledger.records, ledger.profile
    now = float(history.times[-1])
    known = np.flatnonzero(issued.rows >= 0)
    rows = issued.rows[known]
    moved = (history.at(issued.valid_at(knot)) - history.at(issued.time))[known]
    wrong = np.linalg.norm(issued.mixed[knot, rows] - moved, axis=-1)
    if manner.turns:
        wrong = _errors(due, known, moved, wrong, ledger, now)
    if len(wrong):
        kept = np.exp(-due.elapsed_s / manner.memory_s)
        profile[knot] = kept * profile[knot] + (1 - kept) * wrong.mean()
    single = np.linalg.norm(issued.places[:, knot, rows] - moved, axis=-1) / KNOTS[knot]
    foreseen = single.min(axis=0) <= issued.radii[rows]
    records.weigh(known[foreseen], single[:, foreseen], due.elapsed_s)
    expected = issued.radii[rows] * profile[knot] / profile[-1]
    known_s = issued.time - np.maximum(records.began, records.turned)[known]
    knew, grown = known_s >= 0, known_s >= _GROWN * issued.horizon_s
    startled = known[wrong > STARTLED * expected]
    records.began[startled], records.judged[startled] = now, 0
    if knot == len(KNOTS) - 1:
        records.enter(known[knew], wrong[knew], due.elapsed_s)
    return Reckoned(rows, moved, wrong, grown)


def _errors(due: Due, known: Rows, moved: Float64, wrong: Float64, ledger: Ledger, now: float) -> Float64:
    """Errors [n] in metres: the nodes `known` [n] have `moved` [n, 3], `wrong` [n] by so much.

    Takes note of those that have turned back; those that were held along all of their way err by their distance from
    it, as a share of its radius.
    """
    issued, knot = due.issued, due.knot
    rows = issued.rows[known]
    ahead = issued.mixed[knot, rows]
    expected = issued.radii[rows] * ledger.profile[knot] / ledger.profile[-1]
    aside = off_the_way(ahead, moved) / NARROWER
    is_back = ((moved * ahead).sum(axis=-1) < 0) & (wrong > np.maximum(issued.factor * expected, _TURN))
    ledger.records.turned[known[is_back & (aside <= expected)]] = now
    return np.where(issued.turning[rows], np.minimum(wrong, aside), wrong)
