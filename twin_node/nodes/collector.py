"""Collects what a run shows and says, tick by tick, for the report."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from twin_node.forecast import ForecastQuality
from twin_node.messages import Message, convert
from twin_node.nodes.forecast import Forecast
from twin_node.nodes.set_contents import SetContents
from twin_node.nodes.spool import Spool, Tick
from twin_node.nodes.topics import (
    DRIFT,
    FORECAST,
    FRAMES,
    JOINT_STATES,
    SEEN,
    SEPARATION,
    STATE,
    TRAJECTORY,
    TRUSTED_FRAMES,
)
from twin_node.rig.drift_report import DriftReport
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.node import Node
from twin_node.scene import FrameSet, Separation, Tier, TwinState


class CollectorNode(Node):
    """Keeps per-set figures in memory and whole ticks in a spool."""

    def __init__(self, bus: Bus, clock: Clock, spool: Spool | None, rate: float | None = None) -> None:
        """`rate`: seconds of the clock in a real one; None in lockstep, where nothing has a time of its own."""
        super().__init__("collector", bus, clock)
        self.stamps: list[int] = []
        """Of every set that went through the chain, ns."""
        self.arrived = SetContents()
        """Of the sets that came to the chain."""
        self.latencies_ms: list[float] = []
        """From the newest image's stamp to the speed decision, by the run's clock, in real time."""
        self.work_ms: list[float] = []
        """From a set's arrival at the chain to the speed decision, by the wall clock."""
        self.tier_counts: list[list[int]] = []
        self.separations: list[Separation] = []
        self.is_arm_told = False
        """Whether anything was said of an arm; else a made-up one was judged."""
        self.quality: ForecastQuality | None = None
        """The forecaster's own record, as of the newest set."""
        self.newest_state: TwinState | None = None
        """That the model has followed."""
        self._published: int | None = None
        """When that was out, ns; None in lockstep."""
        self.warnings: dict[str, int] = {}
        """Warning -> number of sets it was given with."""
        self.drift: list[DriftReport] = []
        """The first of the drift watch, and every one in which a verdict changed."""
        self.withheld: dict[str, int] = {}
        """Camera -> number of sets that it was left out of because it had moved."""
        self._distrusted: tuple[str, ...] = ()
        self._spool = spool
        self._rate = rate
        self._frames: FrameSet | None = None
        self._seen: TwinState | None = None
        self._forecast: Forecast | None = None
        self._open: dict[int, Tick] = {}
        """By their places among the stamps: of the sets that the model may follow yet."""
        self._begun = 0.0

    def on_configure(self) -> None:
        self.bus.subscribe(FRAMES, self._on_arrival)
        self.bus.subscribe(DRIFT, self._on_drift)
        self.bus.subscribe(TRUSTED_FRAMES, self._on_frames)
        self.bus.subscribe(SEEN, self._on_seen)
        self.bus.subscribe(STATE, self._on_state)
        self.bus.subscribe(FORECAST, self._on_forecast)
        self.bus.subscribe(SEPARATION, self._on_separation)
        for topic in (JOINT_STATES, TRAJECTORY):
            self.bus.subscribe(topic, self._on_arm)

    def start(self) -> None:
        """Count latencies from now on: what came before was start-up."""
        self.latencies_ms.clear()
        self.work_ms.clear()

    def keep_dropped(self, frames: FrameSet) -> None:
        """Spool a set that the twin had no time for; may be called from another thread."""
        if self._spool is not None and self._spool.keeps(frames.stamp):
            views = tuple(view for view in frames.views if view.camera.name not in self._distrusted)
            self._spool.add(Tick(replace(frames, views=views)))

    def _on_arrival(self, frames: FrameSet) -> None:
        self.arrived.add(frames, self.clock.now())
        self._begun = time.perf_counter()

    def _on_frames(self, frames: FrameSet) -> None:
        self._frames = frames

    def _on_drift(self, report: DriftReport) -> None:
        self._count(report.warnings)
        if not self.drift or self.drift[-1].verdicts != report.verdicts:
            self.drift.append(report)
        self._distrusted = report.distrusted
        for camera in report.distrusted:
            self.withheld[camera] = self.withheld.get(camera, 0) + 1

    def _on_seen(self, state: TwinState) -> None:
        self._seen = state

    def _on_state(self, state: TwinState) -> None:
        self._count(state.warnings)
        for place in [place for place, tick in self._open.items() if tick.stamp < state.stamp]:
            self._close(place)
        self.newest_state = state
        self._published = None if self._rate is None else self.clock.now()
        for place in [place for place, tick in self._open.items() if tick.stamp == state.stamp]:
            self._close(place)

    def end(self) -> None:
        """No more will come: sets that the model has not followed it will not follow."""
        for place in tuple(self._open):
            self._close(place)

    def _close(self, place: int) -> None:
        """Spools a set with the newest that the model has followed up to it."""
        tick, model = self._open.pop(place), self.newest_state
        if model is not None and tick.state is not None:
            followed = None if model.stamp == tick.stamp else model.stamp
            state = replace(tick.state, gaussians=model.gaussians, nodes=model.nodes, followed=followed)
            tick = replace(tick, state=state, published=self._published)
            self.tier_counts[place] = _tiers_of(state)
        if self._spool is not None and self._spool.keeps(tick.stamp):
            self._spool.add(tick)

    def _on_forecast(self, forecast: Forecast) -> None:
        self._forecast = forecast
        self.quality = forecast.quality
        self._count(forecast.quality.warnings)

    def _on_arm(self, _: Message) -> None:
        self.is_arm_told = True

    def _count(self, warnings: tuple[str, ...]) -> None:
        for warning in warnings:
            self.warnings[warning] = self.warnings.get(warning, 0) + 1

    def _on_separation(self, message: Message) -> None:
        frames, seen, forecast = self._frames, self._seen, self._forecast
        if frames is None or seen is None or forecast is None:
            return
        separation = convert.separation_from_message(message)
        self.stamps.append(frames.stamp)
        if self._rate is not None:
            self.latencies_ms.append((self.clock.now() - frames.stamp) / (1e6 * self._rate))
        self.work_ms.append((time.perf_counter() - self._begun) * 1e3)
        self.tier_counts.append(_tiers_of(seen))
        self.separations.append(separation)
        self._open[len(self.stamps) - 1] = Tick(frames, seen, forecast.occupancy)


def _tiers_of(state: TwinState) -> list[int]:
    """Gaussians of each tier."""
    counts: list[int] = np.bincount(state.gaussians.tiers, minlength=len(Tier)).tolist()
    return counts
