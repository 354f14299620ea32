"""One run of the whole chain through one failure at one level, beside the baselines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.bag.qos import is_latched
from twin_node.bench.contenders import BASELINES, OURS
from twin_node.bench.stability.failures import FAILURES
from twin_node.bench.stability.pictures import PICTURES, Pictures
from twin_node.bench.stability.scores import Held, Outcome, TickScore, held
from twin_node.bench.stability.shapes import Isometry, Shape
from twin_node.bench.stability.shots import Shot, Stage
from twin_node.cell.shapes import touched_voxels
from twin_node.forecast import BaselineForecaster
from twin_node.nodes.chain import Chain
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.forecast import Forecast
from twin_node.nodes.latency import ASSUMED_LATENCY_NS, Latency
from twin_node.nodes.topics import DRIFT, FORECAST, FRAMES, STATE
from twin_node.rig.drift_report import DriftReport
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import HORIZONS_NS, FrameSet, Grid, Occupancy, TwinState

WARM_UP_S = 0.8
"""Forecasts of the first so many seconds are not scored: things are still getting up to their speed, s."""
SEEN_PX = 20
"""A thing of which all cameras together see fewer pixels has not been seen."""


@dataclass(frozen=True)
class Case:
    """What to run."""

    failure: str
    """A name in `FAILURES`."""
    level: float
    seed: int
    seconds: float
    """Usual length of a run, s."""
    stride: int
    """Every so many sets are taken."""
    width: int
    """Of the cameras' images, px; their height is three quarters of it."""
    chain: ChainParameters


@dataclass(frozen=True)
class CaseResult:
    """What came of it."""

    failure: str
    level: float
    seed: int
    outcomes: Mapping[str, Outcome]
    """Per method: `OURS`, `BASELINES`, `PICTURES`."""
    shape: Shape
    answered: float
    """Share of the rig's sets for which a forecast came; where none comes, who depends on it slows and stops."""
    warnings: Mapping[str, int]
    """Warning -> number of sets that it was given with."""


def run_case(case: Case) -> CaseResult:
    """Runs a case in lockstep: the same case gives the same figures."""
    failure = FAILURES[case.failure]
    scenario = failure.scene(case.level, failure.seconds(case.level, case.seconds)).with_seed(case.seed)
    stage = Stage(scenario.at_width(case.width), case.stride)
    twin = _Followed(stage, case.chain)
    sets = 0
    try:
        for shot in stage:
            sets += 1
            rng = np.random.default_rng([case.seed, shot.frames.sequence])
            frames = failure.perturb(shot, case.level, rng)
            if frames is not None:
                twin.follow(shot, frames)
    finally:
        twin.stop()
    return CaseResult(
        case.failure, case.level, case.seed, twin.outcomes(), twin.shape(), twin.answers / max(sets, 1), twin.warnings
    )


class _Followed:
    """The chain on one stage, and what is scored of it."""

    def __init__(self, stage: Stage, parameters: ChainParameters) -> None:
        self._rig = stage.source.simulated
        scenario = self._rig.scenario
        self._bus, self._clock = LocalBus(is_latched), SteppedClock(scenario.start_ns)
        latency = Latency(ASSUMED_LATENCY_NS, is_measured=False)
        self._chain = Chain(self._bus, self._clock, np.array(scenario.workspace), parameters, latency)
        grid = self._chain.forecaster.grid
        self._baselines = BaselineForecaster(grid, parameters.forecast.carving, parameters.forecast.static)
        self._bus.subscribe(DRIFT, self._on_drift)
        self._bus.subscribe(STATE, self._on_state)
        self._bus.subscribe(FORECAST, self._on_forecast)
        self._chain.start()
        self._drift: DriftReport | None = None
        self._state: TwinState | None = None
        self._forecast: Forecast | None = None
        self._ticks: dict[str, list[TickScore]] = {name: [] for name in (OURS, *BASELINES)}
        self._pictures = Pictures()
        self._isometry = Isometry()
        self.answers = 0
        self.warnings: dict[str, int] = {}

    def follow(self, shot: Shot, frames: FrameSet) -> None:
        """Sends a set through the chain and scores what comes of it."""
        self._state = self._forecast = None
        self._clock.advance_to(frames.stamp)
        self._bus.publish(FRAMES, frames)
        self._chain.model_node.follow()
        if self._drift is None:
            return
        shared = (*self._drift.warnings, *(self._state.warnings if self._state is not None else ()))
        own = self._forecast.quality.warnings if self._forecast is not None else ()
        for warning in (*shared, *own):
            self.warnings[warning] = self.warnings.get(warning, 0) + 1
        if self._state is None or self._forecast is None:
            return
        self.answers += 1
        self._score(shot, self._state, self._forecast.occupancy, bool(shared), bool(own))
        self._isometry.add(self._state.stamp, self._state.gaussians)
        self._pictures.add(shot, self._state, self._chain.model_node.model.render_frozen)

    def stop(self) -> None:
        """Ends the chain, without which nothing of it is ever freed."""
        self._chain.stop()

    def outcomes(self) -> dict[str, Outcome]:
        """What every method made of it."""
        pictures = self._pictures.psnr_db()
        made = {name: Outcome(tuple(ticks), pictures.get(name)) for name, ticks in self._ticks.items()}
        return made | {name: Outcome(psnr_moving_db=pictures.get(name)) for name in PICTURES}

    def shape(self) -> Shape:
        """Jelly and ghosts."""
        shares, lengths = self._isometry.shares, self._isometry.lengths_m
        return Shape(
            float(np.mean(shares)) if shares else None,
            1e3 * float(np.mean(lengths)) if lengths else None,
            self._pictures.ghosts.shares(),
        )

    def _on_drift(self, report: DriftReport) -> None:
        self._drift = report

    def _on_state(self, state: TwinState) -> None:
        self._state = state

    def _on_forecast(self, forecast: Forecast) -> None:
        self._forecast = forecast

    def _score(self, shot: Shot, state: TwinState, ours: Occupancy, shared: bool, own: bool) -> None:
        others = self._baselines.update(state, ours.publish_stamp)
        valid_at = ours.publish_stamp + HORIZONS_NS[-1]
        truth = self._truth(shot, state.frames, ours.grid, valid_at)
        for name, forecast in {OURS: ours, **vars(others)}.items():
            score: Held | None = None
            if shot.seconds >= WARM_UP_S and len(truth):
                score = held(forecast, truth)
            warned = shared or (own and name == OURS)  # a warning of the forecaster's own is not the baselines'
            self._ticks[name].append(TickScore(state.stamp, valid_at, score, warned))

    def _truth(self, shot: Shot, frames: FrameSet, grid: Grid, valid_at: int) -> NDArray[np.int64]:
        """Voxels [n] at a later time of the things that the cameras whose images came see now."""
        world = self._rig.world
        shown = [shot.exact[view.camera.name].owners for view in frames.views]
        seen = {one for one in world.moving_owners if sum(int((o == one).sum()) for o in shown) >= SEEN_PX}
        touched = [touched_voxels(s.placed, grid) for s in world.moving(valid_at) if s.owner in seen]
        return np.unique(np.concatenate([np.empty(0, np.int64), *touched]))
