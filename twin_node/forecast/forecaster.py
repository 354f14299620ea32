"""The forecaster: from the twin's state to occupied, free and unknown space now and up to 200 ms ahead."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.ahead import Ahead, layers_of
from twin_node.forecast.bound import LARGEST_RADIUS, PERSON_SPEED, BoundParameters, CoverageControl
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.evidence import Evidence, Observer
from twin_node.forecast.hiding import Hidden
from twin_node.forecast.judgement import Judgement, Watch
from twin_node.forecast.measured import Measured, start_radii
from twin_node.forecast.narrowed import NarrowedStates
from twin_node.forecast.nearest import nearest
from twin_node.forecast.pace import LONGEST_GAP_S, Pace
from twin_node.forecast.part_motion import PartMotion
from twin_node.forecast.parts import PART_SIZE
from twin_node.forecast.passing import passed_between
from twin_node.forecast.prediction import Prediction, Predictor
from twin_node.forecast.resting import RESTING_S
from twin_node.forecast.sighting import Sighted, sighted
from twin_node.forecast.sights import CarvingParameters
from twin_node.forecast.static import StaticParameters
from twin_node.forecast.tracks import REACH, Tracks
from twin_node.forecast.verdicts import WITNESSES
from twin_node.robot import ArmModel
from twin_node.scene import HORIZONS_NS, Bool, Float64, Grid, Occupancy, OccupancyLayer, TwinState, read_only

_NEIGHBOURS = 8
"""Forecast places that are looked at about a part: those nearest to it."""
JUDGED_EVERY_NS = 50_000_000
"""Forecasts are judged this often: those of neighbouring sets are right or wrong together."""
TIMELY_NS = 17_000_000
"""A set tells of forecasts for so much earlier or later, half the time between sets at 30 Hz, or half the time since
the set before it: of several that could, the one nearest in time judges a forecast, and each is judged by one."""

MOTION_SHOWS_NS = 150_000_000
"""After so long it shows what moved when the first images came; forecasts made before could not know, ns."""


@dataclass(frozen=True)
class ForecastParameters:
    """Parameters of the forecaster's steps."""

    carving: CarvingParameters = field(default_factory=CarvingParameters)
    bound: BoundParameters = field(default_factory=BoundParameters)
    static: StaticParameters = field(default_factory=StaticParameters)


@dataclass(frozen=True)
class ForecastQuality:
    """How well the forecasts have been keeping what they promise."""

    coverage: float
    """Share of what was seen to move (points that depth cameras measure, pixels of others) that lay inside the forecast
    made for that time, over the last 120 judged image sets; NaN before the first has come due."""
    target: float
    """Coverage aimed at."""
    bound_radius: float
    """Median radius of the bound at the last horizon, m; 0 where nothing moves."""
    factor: float
    """What the parts' scales are multiplied by to reach the target."""
    expert_weights: Float64
    """[E] mean weights of persistence, constant velocity, damped, constant acceleration, autoregression, free fall."""
    warnings: tuple[str, ...] = ()
    """What went wrong with the last forecast and what was forecast instead, and what earlier ones turn out to miss."""


@dataclass(frozen=True)
class ForecastResult:
    """The forecast on one state, and what obstacles are told by beside it."""

    occupancy: Occupancy
    motion: PartMotion
    """Where the parts are, how they move, their bounds and their experts."""
    hidden: Hidden
    """What may be in the unknown space."""
    sighted: Sighted
    """What is seen to move."""


class Forecaster:
    """Forecasts the occupancy of one grid, state by state."""

    def __init__(self, grid: Grid, parameters: ForecastParameters | None = None, arm: ArmModel | None = None) -> None:
        """`arm`: the one that the states' joints belong to; its own space is left out. None: there is none."""
        self.grid = grid = replace(grid, origin=read_only(grid.origin))
        self.parameters = parameters or ForecastParameters()
        self._narrowed = NarrowedStates(grid)
        self._observer = Observer(grid, self.parameters.carving, self.parameters.static, arm)
        self._control = CoverageControl(self.parameters.bound)
        self._tracks = Tracks()
        self._predictor = self._new_predictor()
        self._newest = _NEVER
        """Stamp of the last state, ns."""
        self._pace = Pace()
        self._begins_anew = True
        """Whether nothing is known of motion that holds for the next state."""
        self._anew_at = _NEVER
        """Stamp of the last state that nothing known of motion held for, ns."""
        self._depth_at: int | None = None
        """Stamp of the last state with depth, ns."""
        self._issued: deque[_Issued] = deque(maxlen=64)
        self._judged_at = 0
        self._due: _Issued | None = None
        self._bound_radius = 0.0
        self._watch = Watch()
        self._sees_motion_from = 0
        self._warnings: tuple[str, ...] = ()

    @property
    def quality(self) -> ForecastQuality:
        """The record as of the last update."""
        return ForecastQuality(
            coverage=self._control.coverage,
            target=self.parameters.bound.coverage,
            bound_radius=self._bound_radius,
            factor=self._control.factor,
            expert_weights=self._mean_weights(),
            warnings=self._warnings + self._watch.warnings,
        )

    def update(self, state: TwinState, publish_stamp: int) -> ForecastResult:
        """Occupancy at `publish_stamp` + `HORIZONS_NS`, on the evidence up to `state.stamp` (both ns, one clock).

        Raises `ForecastError` where it is to be read before its evidence, for a state older than the last, and for
        images or masks that are not of their camera's size.
        """
        if state.stamp < self._newest:
            raise ForecastError(
                f"state: expected a stamp of {self._newest} ns or later, found {state.stamp} ns; sort the states, or "
                "begin with a new forecaster"
            )
        if publish_stamp < state.stamp:
            early_ms = (state.stamp - publish_stamp) / 1e6
            raise ForecastError(
                f"publish_stamp: expected the evidence's stamp or later, found {early_ms:g} ms before it; give both on "
                "one clock"
            )
        state, self._newest = self._narrowed.of(state), state.stamp
        horizons = (publish_stamp - state.stamp + np.array(HORIZONS_NS)) * 1e-9
        self._sees_motion_from = self._sees_motion_from or state.stamp + MOTION_SHOWS_NS
        evidence = self._follow(state, float(horizons[-1]))
        self._judge(state, evidence)
        self._predictor.vouch(self._foreseen(state.stamp, evidence.parts.centers))
        places = self._tracks.positions[-1] + self._predictor.alone
        prediction = self._predict(horizons)
        may_start = evidence.resting if self._had_depth(state.stamp, RESTING_S) else np.zeros(0, np.int64)
        started = np.minimum(start_radii(horizons), LARGEST_RADIUS)
        layers = self._layers(evidence, prediction, may_start, started)
        seen = sighted(self._observer.grid, evidence.parts, may_start, prediction, started, horizons)
        motion = self._motion(evidence, prediction)
        if self._begins_anew:
            self._predictor = self._new_predictor()
        valid_at, taken = publish_stamp + HORIZONS_NS[-1], layers[-1].indices.astype(np.int64)
        ahead, factor = evidence.parts.centers + prediction.displacements[-1], self._control.factor
        self._issued.append(_Issued(state.stamp, valid_at, taken, places, factor, ahead, prediction.radii[-1]))
        unseen = evidence.unseen.result()
        occupancy = Occupancy(
            stamp=state.stamp,
            publish_stamp=publish_stamp,
            grid=self.grid,
            layers=layers,
            static=evidence.static,
            unknown_runs=unseen.unknown_runs,
        )
        return ForecastResult(occupancy, motion, unseen.hidden, seen)

    def _follow(self, state: TwinState, ahead_s: float) -> Evidence:
        """What a state shows, and forecasts of all that moves in it for so long (s) from then.

        Nothing that was known of motion before a pause is gone on with.
        """
        paused = self._pace.pauses_before(state.stamp)
        anew = self._begins_anew = self._begins_anew or paused
        evidence = self._observer.observe(state, anew)
        if anew:
            self._tracks, self._anew_at, self._begins_anew = Tracks(), state.stamp, False
        has_depth = any(view.depth is not None for view in state.frames.views)
        is_told_apart = has_depth or len(state.frames.views) >= WITNESSES
        alone = (not is_told_apart and any(mask.any() for mask in state.moving_masks)) or evidence.has_lone_sights
        told = ((paused and evidence.parts.count > 0, _PAUSED), (alone, _ALONE))
        self._warnings = (*(line for is_so, line in told if is_so), *evidence.warnings)
        if has_depth:
            self._depth_at = state.stamp
        motion, whole = evidence.motion, evidence.whole
        association = self._tracks.follow(state.stamp * 1e-9, evidence.parts.centers, motion.velocities)
        # parts of a hull of silhouettes come and go with it: that they are new says nothing of what they are part of
        landing = evidence.landing
        known = Measured(
            motion.sigmas, whole.flying, whole.alone, whole.falling, floors=landing.floors, clear_s=landing.clear_s
        )
        measured = known if anew or self._had_depth(state.stamp, LONGEST_GAP_S) else None
        factor = self._control.factor
        self._predictor.advance(self._tracks.history, association, ahead_s, measured, factor, evidence.near)
        return evidence

    def _had_depth(self, stamp: int, within_s: float) -> bool:
        """Whether any camera has measured depth of late, as seen at `stamp` (ns): single depth images get lost."""
        return self._depth_at is not None and stamp - self._depth_at <= within_s * 1e9

    def _layers(
        self, evidence: Evidence, prediction: Prediction, may_start: NDArray[np.int64], started: Float64
    ) -> tuple[OccupancyLayer, ...]:
        """What moves takes at every horizon; cells that `may_start` reach `started` [H] (m) from where they are."""
        moved = (prediction.displacements, prediction.radii, prediction.turning, prediction.swerves)
        return layers_of(self.grid, Ahead(evidence.parts, *moved, self._observer.places(may_start), started))

    def _motion(self, evidence: Evidence, prediction: Prediction) -> PartMotion:
        """That of the parts, and what they pass between two layers; takes note of how wide their bounds are."""
        radii = prediction.radii
        self._bound_radius = float(np.median(radii[-1])) if radii.shape[1] else 0.0
        passed = passed_between(self.grid, evidence.parts, prediction.displacements, radii)
        experts = self._predictor.weights.argmax(axis=0).astype(np.uint8)
        places, velocities = read_only(self._tracks.positions[-1]), read_only(self._tracks.velocities)
        moved, sigmas = read_only(prediction.displacements), read_only(evidence.motion.sigmas)
        return PartMotion(places, velocities, read_only(radii), experts, sigmas, passed, moved)

    def _new_predictor(self) -> Predictor:
        """Without any record. Nothing falls out of the grid: below it is a table or the floor."""
        return Predictor(self.parameters.bound, turns=True, floor=float(self.grid.origin[2]) + PART_SIZE)

    def _mean_weights(self) -> Float64:
        weights = self._predictor.weights
        return weights.mean(axis=1) if weights.shape[1] else np.full(len(weights), 1 / len(weights))

    def _judge(self, state: TwinState, evidence: Evidence) -> None:
        """Scores the forecast made for now; parts that nobody saw when it was made are left out."""
        due = None
        timely = max(TIMELY_NS, (state.stamp - self._issued[-1].stamp) // 2) if self._issued else TIMELY_NS
        ripe = [issued for issued in self._issued if issued.valid_at <= state.stamp + timely]
        if ripe:  # in the order of their times: one that had less to bridge may be valid before an earlier one
            due = self._due = max(ripe, key=lambda issued: issued.valid_at)
            waiting = (issued for issued in self._issued if issued.valid_at > state.stamp + timely)
            self._issued = deque(waiting, self._issued.maxlen)
        if due is None or state.stamp - due.valid_at > timely or state.stamp - self._judged_at < JUDGED_EVERY_NS:
            return
        known = self._tracks.born <= due.stamp * 1e-9
        judgement = Judgement(state, self._observer.margin, self._observer.tables, due.indices, evidence.parts)
        found = judgement.of(known)
        if due.stamp >= self._sees_motion_from:
            self._watch = self._watch.after(judgement.of_all(partial(self._observer.frees, state)))
        if found.seen:
            elapsed = (state.stamp - self._judged_at) / (due.valid_at - due.stamp)
            steady = judgement.of(known & self._predictor.unstartled_since(due.stamp * 1e-9))
            self._control.observe(found.share, steady.share if steady.seen else None, due.factor, elapsed)
        if known.any() and due.places.shape[1]:
            missed = _missed(due.places, evidence.parts.centers[known])
            self._predictor.judge_experts(missed)
        self._judged_at = state.stamp

    def _foreseen(self, stamp: int, centers: Float64) -> Bool:
        """[M] parts, by their centres, that lie where the newest forecast whose time has come had some part.

        One whose time was longer ago than it looked ahead says nothing of now, nor does one of before a pause, or the
        first after it: that foresaw everything.
        """
        due = self._due
        if due is None or stamp - due.valid_at > HORIZONS_NS[-1] or due.stamp <= self._anew_at:
            return np.zeros(len(centers), np.bool_)
        if len(due.radii) == 0 or len(centers) == 0:
            return np.zeros(len(centers), np.bool_)
        count = min(_NEIGHBOURS, len(due.radii))
        distances, rows = nearest(centers, due.ahead, count)
        return np.asarray((distances <= due.radii[rows] + PART_SIZE).any(axis=1))

    def _predict(self, horizons: Float64) -> Prediction:
        """Where the parts will be; worst case for those of which the experts make nothing finite."""
        found = self._predictor.predict(horizons, self._control.factor)
        moved, radii = found.displacements, found.radii
        lost = ~(np.isfinite(moved).all(axis=(0, 2)) & np.isfinite(radii).all(axis=0))
        if lost.any():
            moved[:, lost] = 0
            radii[:, lost] = PERSON_SPEED * horizons[:, None]
            self._warnings += (
                f"forecast: {lost.sum()} parts became non-finite: worst case for them, tracks begun anew",
            )
            self._begins_anew = True
        return found


@dataclass(frozen=True)
class _Issued:
    """A forecast waiting for the truth."""

    stamp: int
    valid_at: int
    indices: NDArray[np.int64]
    places: Float64
    """[E, M, 3] where each expert alone forecast the parts, m."""
    factor: float
    """On its calibrated radii."""
    ahead: Float64
    """[M, 3] where the parts were to be, m."""
    radii: Float64
    """[M] and how far from there at most, m."""


_PAUSED = (
    "forecast: nothing is known of how things move after a pause in the images: worst case for them, tracks begun anew"
)
_ALONE = (
    "forecast: one camera alone shows that something moves, without depth of it, and not how far away: all along its "
    "lines of sight space is unknown, and where it will be is not foreseen; let a second camera see there, or one that "
    "measures its depth"
)
_NEVER = np.iinfo(np.int64).min // 2
_NOWHERE = 1e6
"""Stands for a place that is not finite, m."""


_ASKED = 256
"""Most parts that are looked for about the experts' places: they are told apart by shares of them."""


def _missed(places: Float64, centers: Float64) -> Float64:
    """Share [E] of parts at `centers` [n, 3] that are more than a part from every place [E, M, 3] of an expert."""
    known = np.where(np.isfinite(places), places, _NOWHERE)
    centers = centers[:: -(-len(centers) // _ASKED)]
    shares: Float64 = np.mean(nearest(centers, known, within=REACH).distances[..., 0] > REACH, axis=1)
    return shares
