"""Forecasts of a log with exact truth by models of one size, and the baselines made of the same states."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from twin_node.bench.errors import BenchError
from twin_node.bench.pareto.sizes import SIZES
from twin_node.forecast import BaselineForecaster, Forecaster, default_grid
from twin_node.forecast.comparison import Comparison, Score
from twin_node.nodes.chain import ChainParameters, make_model
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.replay import ASSUMED_LATENCY_NS
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.topics import TRUTH_OCCUPANCY
from twin_node.nodes.truth import VoxelTruth
from twin_node.scene import FrameSet

OURS = "ours"
BASELINES = ("persistence", "constant_velocity", "worst_case")
WARM_UP_NS = 400_000_000
"""Forecasts of so long are made and not scored: nothing has had time to be seen moving, ns."""


@dataclass(frozen=True)
class ForesightJob:
    """What to forecast."""

    data: str
    """What the chart calls the log."""
    size: str
    log: Path
    frames: int
    """Sets, from the first."""
    chain: ChainParameters


@dataclass(frozen=True)
class ForesightPoint:
    """One kind of forecast on the states of one size."""

    name: str
    score: Score
    forecast_ms: float
    """Median of one core per set; of all baselines together."""


def has_truth(log: Path) -> bool:
    """Whether a log carries the exact occupancy."""
    with LogSession(log) as session:
        return any(topic.name == TRUTH_OCCUPANCY for topic in session.log.topics)


def foresee(job: ForesightJob) -> list[ForesightPoint]:
    """Follows and forecasts the log in lockstep on one core; ours first."""
    torch.set_num_threads(1)
    size = SIZES[job.size]
    chain = replace(job.chain, model=size.model(job.chain.model))
    with LogSession(job.log) as session:
        source = LogSource(session, SynchronizerParameters(size.width))
        grid = default_grid(source.workspace, chain.grid.voxel_size)
        model, arm = make_model(chain), chain.arm.arm()
        forecaster = Forecaster(grid, chain.forecast, arm)
        baselines = BaselineForecaster(grid, chain.forecast.carving, chain.forecast.static, arm)
        comparison = Comparison(VoxelTruth(session.log), BASELINES[0])
        laps = []
        begin = None
        for frames in _first(source, job.frames):
            begin = frames.stamp if begin is None else begin
            state = model.update(frames)
            times = [time.process_time()]
            ours = forecaster.update(state, state.stamp + ASSUMED_LATENCY_NS)
            times.append(time.process_time())
            others = baselines.update(state, state.stamp + ASSUMED_LATENCY_NS)
            times.append(time.process_time())
            laps.append(np.diff(times))
            forecasts = {OURS: ours, **{name: getattr(others, name) for name in BASELINES}}
            comparison.add(state, forecasts if state.stamp - begin >= WARM_UP_NS else {})
    scores = comparison.scores()
    if not scores:
        raise BenchError(f"{job.log}: expected more than 0.7 s of images to score forecasts on, found {len(laps)} sets")
    ours_ms, others_ms = 1e3 * np.median(laps[1:], axis=0)
    costs = {OURS: ours_ms, **dict.fromkeys(BASELINES, others_ms)}
    return [ForesightPoint(name, scores[name], float(cost)) for name, cost in costs.items()]


def _first(source: LogSource, count: int) -> Iterator[FrameSet]:
    for number, frames in enumerate(source):
        if number == count:
            return
        yield frames
