"""The forecast of nodes: experts mixed by their records, and a bound about the mixture."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from twin_node.forecast.bound import LARGEST_RADIUS, MEMORY_S, Bound, BoundParameters, Expected
from twin_node.forecast.experts import EXPERT_NAMES, KNOTS, PARABOLA_S, Autoregression, History
from twin_node.forecast.leading import Guides, Led, led
from twin_node.forecast.measured import Measured
from twin_node.forecast.neighbours import Closest
from twin_node.forecast.outlook import Standing, outlook, weighed
from twin_node.forecast.reaches import Known, Span, reaches, staleness
from twin_node.forecast.reckoning import Due, Issued, Ledger, Manner, reckon
from twin_node.forecast.records import USUAL_ERROR, Records, Rows
from twin_node.forecast.swerving import Swerves, swerves_of
from twin_node.scene import Bool, Float64
from twin_node.side_thread import Task


@dataclass(frozen=True)
class Association:
    """Which nodes of the sample before go on in the nodes of now; -1 for none."""

    paths: Rows
    """[M] whose path each continues."""
    records: Rows
    """[M] whose record of errors each takes over."""


@dataclass(frozen=True)
class Prediction:
    """Where nodes will be, at H horizons."""

    displacements: Float64
    """[H, M, 3] of the mixture, m."""
    radii: Float64
    """[H, M] bound about the displaced nodes, m."""
    turning: Bool
    """[M] nodes that have turned back of late: their bounds hold about all of their way, from as far behind where they
    are now as ahead (`turning.whole_ways`)."""
    swerves: Swerves
    """Where they get if their accelerations last."""


_STRAIGHT_ON, _FALLING = EXPERT_NAMES.index("constant_velocity"), EXPERT_NAMES.index("free_fall")
"""Experts that lead what is bounded by its reach alone: most things, and what flies."""
_ACCELERATING = EXPERT_NAMES.index("constant_acceleration")
_SWERVE = 0.5
"""Accelerations lead no farther aside than so much of the largest radius: 99 % of human motion stays within that."""
_NOW_S = 0.002
"""A forecast for so soon after the last sample is judged by it, s: what rounding and jitter make of equal times."""
_TRUST_SHARPNESS, _TRUST_SHARE = 0.02, 0.002
"""An expert is trusted 1/e as much as the best one if it misses so much more, relative and in shares of what moves."""


_JUDGEMENTS = 13.0
"""Judgements in which earlier ones lose their say, however far apart: 0.87 s at 30 Hz, where every other set judges."""


class Predictor:
    """Forecasts nodes sample by sample; what is learnt and calibrated is learnt from what came true.

    Used alike for parts of moving space and for the trajectories of `bench forecast`.
    """

    def __init__(self, parameters: BoundParameters | None = None, turns: bool = False, floor: float = -np.inf) -> None:
        """`turns`: nodes that turn back are told from others, and judged by all of their way (`Prediction.turning`);
        those that accelerate are told of (`Prediction.swerves`).

        `floor`: height in metres below which nothing goes.
        """
        self.bound = Bound(parameters)
        self._turns, self._floor = turns, floor
        self._factor = 1.0
        self.autoregression = Autoregression()
        self._horizon_s = 0.2
        self._measured: Measured | None = None
        self._records = Records()
        self._path_began = np.zeros(0)
        self._trust = np.ones(len(EXPERT_NAMES))
        self._missed = np.zeros(len(EXPERT_NAMES))
        self._issued: deque[Issued] = deque()
        self._profile = np.array(KNOTS) * USUAL_ERROR
        self._history = History(np.zeros(0), np.zeros((0, 0, 3)))
        self._features = np.zeros((0, 3, 0))
        self._shares = np.zeros((len(EXPERT_NAMES), 0))
        self._weights: Float64 | None = None
        """`weights`, until something that they come of changes."""
        self._cues = np.zeros((0, 0))
        self._speeds = np.zeros(0)
        self._expected = Expected(np.zeros(0), np.zeros(0))
        self._learnt_at = np.full(len(KNOTS), -np.inf)
        self.alone = np.zeros((len(EXPERT_NAMES), 0, 3))
        """[E, M, 3] displacements by each expert alone at the horizon of the last `advance`, m."""

    @property
    def weights(self) -> Float64:
        """[E, M] of the experts, in the order of `EXPERT_NAMES`.

        Where the velocity is measured, what has no record yet goes on at it, or falls.
        """
        if self._weights is None:
            self._weights = weighed(self._shares, self._trust, self._alone)
        return self._weights

    @property
    def _alone(self) -> Rows:
        """[M] experts that lead a node alone; -1 for none."""
        if self._measured is None:
            return np.full(len(self._records.born), -1, np.int64)
        first = np.where(self._measured.flying, _FALLING, _STRAIGHT_ON)
        return np.where(self._newcomers, first, -1)

    @property
    def _floors(self) -> Float64:
        """[M] heights in metres that the nodes do not get below."""
        count = self._history.positions.shape[1]
        return np.full(count, self._floor) if self._measured is None else np.maximum(self._floor, self._measured.floors)

    def advance(
        self,
        history: History,
        association: Association,
        horizon_s: float,
        measured: Measured | None = None,
        factor: float = 1.0,
        near: Task[Closest] | None = None,
    ) -> None:
        """Takes in where nodes are now, the last sample of `history`, and forecasts them for `horizon_s` from now.

        Earlier samples of the history are the paths of the nodes of now. What was forecast for the time since the last
        sample is judged. `measured`: what is known of the velocities that the paths end with, if they are. `factor`: on
        calibrated bounds. `near`: who asks for the neighbours of the nodes (`neighbours.closest`), if somebody does.
        """
        self._horizon_s, self._measured, self._factor = horizon_s, measured, factor
        self._history = history
        self._records = self._records.inherited(association.records, history.times[-1])
        before = np.append(self._path_began, history.times[-1])
        self._path_began = before[np.where(association.paths < 0, len(before) - 1, association.paths)]
        self._inherit(association.paths)
        self._judge()
        self._issue(None if near is None else near.result())

    def _inherit(self, paths: Rows) -> None:
        """Says whose forecasts wait for the truth: each node of now goes on with one of before, as `paths` [M] tell."""
        if not self._issued:
            return
        rows = np.full((len(self._issued), len(self._issued[0].rows) + 1), -1, np.int64)
        for before, issued in zip(rows, self._issued, strict=True):
            before[:-1] = issued.rows
        for own, issued in zip(rows.take(paths, axis=1), self._issued, strict=True):
            issued.rows = own

    def judge_experts(self, missed: Float64) -> None:
        """Takes in which share [E] of what moves now each expert alone would have missed.

        Paths of parts of a hull are put together from velocities; this tells whether they lead where things turn up.
        """
        rate = 1 - np.exp(-1 / _JUDGEMENTS) if self._missed.any() else 1.0
        self._missed = self._missed + rate * (missed - self._missed)
        self._weights = None
        best = float(self._missed.min())
        self._trust = np.exp(-(self._missed - best) / (_TRUST_SHARPNESS * best + _TRUST_SHARE))

    def vouch(self, foreseen: Bool) -> None:
        """Tells which of the nodes [M] are where something was forecast: they begin nothing new, however they came."""
        old = self._history.times[-1] - self._horizon_s
        self._weights = None
        self._records.began = np.where(foreseen, np.minimum(self._records.began, old), self._records.began)

    def unstartled_since(self, time: float) -> Bool:
        """[M] nodes that began nothing new after `time` (s), nor turned back."""
        unstartled: Bool = (self._records.began <= time) & (self._records.turned <= time)
        return unstartled

    def predict(self, horizons: Float64, factor: float = 1.0) -> Prediction:
        """Displacements and bounds of the nodes of the last `advance` after horizons [H] in seconds.

        `factor`: on calibrated bounds.
        """
        found = self._led(horizons)
        mixed, accelerated = found.mixed, found.single[_ACCELERATING]
        left = np.minimum(self._floors - self._history.positions[-1][:, 2], 0)
        for places in (mixed, accelerated):  # else what is about to bounce would be forecast below the grid
            places[..., 2] = np.maximum(places[..., 2], left)
        radii = self._within(horizons, factor)
        swerves = swerves_of(mixed, radii, accelerated, _SWERVE * LARGEST_RADIUS)
        return Prediction(mixed, radii, self._turning, Swerves(swerves.displacements, swerves.held & self._swerving))

    def _within(self, horizons: Float64, factor: float) -> Float64:
        """[H, M] radii about the nodes after horizons [H] (s), m."""
        times = horizons / float(horizons[-1])
        shares = np.interp(times, [0.0, *KNOTS], [0.0, *np.minimum(self._profile / self._profile[-1], 1)])
        return reaches(self._known, self.bound, factor, Span(horizons, shares, capped=True))

    @property
    def _known(self) -> Known:
        """What the bounds of the nodes come of."""
        records, now = self._records, float(self._history.times[-1])
        kept = (records.born, records.began, records.turned)
        stale_s = staleness(self._history.times)
        return Known(now, self._horizon_s, self._expected, *kept, self._speeds, self._measured, stale_s)

    @property
    def _swerving(self) -> Bool:
        """[M] nodes whose path is as long as what accelerations are fitted to: what was before is made up.

        None where velocities are measured: the bound about where these lead holds what people do (`Measured.most`).
        """
        may = self._turns and self._measured is None
        swerving: Bool = may & (self._history.times[-1] - self._path_began >= PARABOLA_S)
        return swerving

    @property
    def _newcomers(self) -> Bool:
        """[M] nodes whose velocity is measured, and which have no record yet."""
        if self._measured is None:
            return np.zeros(len(self._records.born), np.bool_)
        known_s = self._history.times[-1] - self._records.born
        return self._measured.newcomers(known_s, self._ages, self._horizon_s)

    @property
    def _turning(self) -> Bool:
        """[M] nodes that have turned so lately that another turn must be expected.

        One turn spoils the forecasts of one horizon, and the target allows one horizon to be spoilt in so many.
        """
        if not self._turns:
            return np.zeros(len(self._records.turned), np.bool_)
        memory_s = self._horizon_s / (1 - self.bound.parameters.coverage)
        turning: Bool = self._history.times[-1] - self._records.turned < memory_s
        return turning

    @property
    def _ages(self) -> Float64:
        ages: Float64 = self._history.times[-1] - self._records.began
        return ages

    def single(self, horizons: Float64) -> Float64:
        """[E, H, M, 3] displacements of every expert."""
        return self._led(horizons).single

    def _led(self, horizons: Float64) -> Led:
        learnt = self.autoregression.weights(horizons / self._horizon_s)
        return led(Guides(self._history, self._features, self._floors), learnt, self.weights, horizons)

    def _issue(self, near: Closest | None) -> None:
        """Has every expert forecast the places at the knots."""
        standing = Standing(self._records.squared, self._records.errors, self._trust, self._alone)
        shares = np.array(KNOTS)
        learnt, horizons = self.autoregression.weights(shares), shares * self._horizon_s
        found = outlook(self._history, standing, self._floors, learnt, horizons, near)
        self._features, self._shares, self._cues = found.features, found.shares, found.cues
        self._speeds = np.linalg.norm(self._history.line[0], axis=-1)
        self._weights = None
        self.alone = found.led.single[:, -1]
        time, count = float(self._history.times[-1]), self._history.positions.shape[1]
        self._expected = self.bound.expected(self._cues)
        (radii,) = reaches(self._known, self.bound, 1.0, Span(np.array([self._horizon_s]), np.ones(1), capped=False))
        rows, turning, span = np.arange(count), self._turning, self._horizon_s
        forecast = (self._features, found.led.single, found.led.mixed, self._cues, radii, turning, self._factor)
        self._issued.append(Issued(time, span, rows, *forecast))

    def _judge(self) -> None:
        """Judges every forecast for a time since the last sample, and learns from it."""
        now = float(self._history.times[-1])
        due: list[Due] = []
        for issued in self._issued:
            while issued.due < len(KNOTS) and issued.valid_at(issued.due) <= now + _NOW_S:
                due.append(Due(issued, issued.due, self._since_last(issued)))
                issued.due += 1
        while self._issued and self._issued[0].due == len(KNOTS):
            self._issued.popleft()
        if not due:
            return
        ledger = Ledger(self._records, self._profile, self.autoregression)
        manner = Manner(MEMORY_S, self._turns)
        for one, found in zip(due, reckon(due, self._history, ledger, manner), strict=True):
            if one.knot == len(KNOTS) - 1:
                cues, radii = one.issued.cues[found.rows], one.issued.radii[found.rows]
                time = one.issued.valid_at(one.knot)
                self.bound.observe(time, cues, found.wrong, radii, one.elapsed_s, found.grown)

    def _since_last(self, issued: Issued) -> float:
        """Time in seconds since the knot that is due was learnt about last; takes note of this one.

        Where horizons have become shorter, forecasts for later may have been learnt from already: then it is 0.
        """
        knot, valid_at = issued.due, issued.valid_at(issued.due)
        elapsed = min(max(valid_at - self._learnt_at[knot], 0.0), issued.horizon_s)
        self._learnt_at[knot] = max(valid_at, self._learnt_at[knot])
        return float(elapsed)
