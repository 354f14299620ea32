"""Forecasts of a log with exact truth by models of one size, and the baselines made of the same states."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import torch

from twin_node.bench.contenders import BASELINES, OURS
from twin_node.bench.errors import BenchError
from twin_node.bench.pareto.following import Follower, settled_ms
from twin_node.forecast.comparison import Score
from twin_node.model.first_light import once_lit
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.sizes import SIZES
from twin_node.nodes.truth import VoxelTruth, has_exact_truth


@dataclass(frozen=True)
class ForesightJob:
    """What to forecast."""

    data: str
    """What the chart calls the log."""
    size: str
    log: Path
    start_offset_s: float
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
        return has_exact_truth(session.log)


def foresee(job: ForesightJob) -> list[ForesightPoint]:
    """Follows and forecasts the log in lockstep on one core; ours first."""
    torch.set_num_threads(1)
    size = SIZES[job.size]
    chain = replace(job.chain, model=size.model(job.chain.model))
    with LogSession(job.log, start_offset_s=job.start_offset_s) as session:
        arm = chain.arm.arm()
        source = LogSource(session, replace(chain.synchronizer, width=size.width), arm.joint_names)
        follower = Follower(chain, arm, source.workspace, VoxelTruth(session.log))
        for _ in follower.follow(islice(once_lit(source), job.frames)):
            pass
    scores, laps = follower.scores, follower.laps
    if not scores:
        raise BenchError(
            f"{job.log}: expected more than 0.7 s of images to score forecasts on, found {len(laps.model)} sets"
        )
    costs = {OURS: settled_ms(laps.forecast), **dict.fromkeys(BASELINES, settled_ms(laps.baselines))}
    return [ForesightPoint(name, scores[name], cost) for name, cost in costs.items()]
