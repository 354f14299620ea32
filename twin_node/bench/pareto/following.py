"""Follows sets with a model and forecasts each, on one core, beside the baselines of the same states."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from twin_node.bench.contenders import OURS
from twin_node.forecast import BaselineForecaster, Forecaster, ForecastQuality, default_grid
from twin_node.forecast.comparison import Comparison, Score, Truth
from twin_node.model import WindowModel
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.latency import ASSUMED_LATENCY_NS
from twin_node.nodes.spool import Tick
from twin_node.robot import ArmModel
from twin_node.scene import Float64, FrameSet, Tier, TwinState

WARM_UP_NS = 400_000_000
"""Forecasts of so long are made and not scored: nothing has had time to be seen moving, ns."""


@dataclass
class Laps:
    """What every set has cost, of one core, ms, and how much of the model moved."""

    model: list[float] = field(default_factory=list)
    mapper: list[float] = field(default_factory=list)
    """Refinement of what stands still, which a live twin does when the set's cloud is out."""
    forecast: list[float] = field(default_factory=list)
    baselines: list[float] = field(default_factory=list)
    """All of them together."""
    sent: list[int] = field(default_factory=list)
    """Bytes that the set added or changed."""
    moving: list[int] = field(default_factory=list)
    """Gaussians of all tiers but STATIC and ROBOT."""


class Follower:
    """One model and one forecaster on one grid."""

    def __init__(self, chain: ChainParameters, arm: ArmModel | None, workspace: Float64, truth: Truth) -> None:
        """`workspace` [2, 3] m; `arm` None: its own space is not left out."""
        grid = default_grid(workspace, chain.grid.voxel_size)
        self.model = WindowModel(chain.model, arm=arm)
        self.laps = Laps()
        self._forecaster = Forecaster(grid, chain.forecast, arm)
        self._baselines = BaselineForecaster(grid, chain.forecast.carving, chain.forecast.static, arm)
        self._truth = truth
        self._comparison = Comparison(truth, "persistence")

    @property
    def scores(self) -> dict[str, Score]:
        """Of ours and the baselines; empty where no forecast's time has come."""
        return self._comparison.scores()

    @property
    def quality(self) -> ForecastQuality:
        """The forecaster's own record."""
        return self._forecaster.quality

    def follow(self, sets: Iterable[FrameSet]) -> Iterator[Tick]:
        """Every set in turn, and the state that it led to."""
        begin: int | None = None
        for frames in sets:
            begin = frames.stamp if begin is None else begin
            started = time.process_time()
            state = self.model.update(frames)
            updated = time.process_time()
            self.laps.model.append(1e3 * (updated - started))
            self.model.refine()
            self.laps.mapper.append(1e3 * (time.process_time() - updated))
            self.laps.sent.append(self.model.bytes_per_frame)
            counts = self.model.tier_counts
            self.laps.moving.append(sum(counts[tier] for tier in (Tier.RIGID, Tier.DEFORMABLE, Tier.TRANSIENT)))
            self._forecast(state, state.stamp - begin >= WARM_UP_NS)
            yield Tick(frames, state)

    def _forecast(self, state: TwinState, is_warm: bool) -> None:
        publish = state.stamp + ASSUMED_LATENCY_NS
        times = [time.process_time()]
        ours = self._forecaster.update(state, publish).occupancy
        times.append(time.process_time())
        others = self._baselines.update(state, publish)
        times.append(time.process_time())
        self.laps.forecast.append(1e3 * (times[1] - times[0]))
        self.laps.baselines.append(1e3 * (times[2] - times[1]))
        self._truth.observe(state, others.persistence)
        self._comparison.add(state, {OURS: ours, **vars(others)} if is_warm else {})


def settled_ms(laps: list[float]) -> float:
    """Median of all sets but the first, which starts the model, ms."""
    return float(np.median(laps[1:])) if len(laps) > 1 else float("nan")
