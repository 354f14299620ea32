"""The status node: how the twin is doing, once a second."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from twin_node.messages import convert, serialize
from twin_node.nodes.forecast import Forecast
from twin_node.nodes.latency import Latency
from twin_node.nodes.topics import DRIFT, FORECAST, GAUSSIANS_MOVING, OBSTACLES, OCCUPANCY, SEEN, STATE, STATUS
from twin_node.rig.drift_report import DriftReport
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.node import Node
from twin_node.scene import Tier, TwinState

PERIOD_NS = 1_000_000_000
"""Status goes out at 1 Hz of evidence time."""
PER_SET = (GAUSSIANS_MOVING, OCCUPANCY, OBSTACLES)
"""Topics published with every set; their size is sampled whenever status goes out."""


class StatusNode(Node):
    """Counts what goes by and publishes `/twin/status`."""

    def __init__(
        self, bus: Bus, clock: Clock, latency: Latency, parameters: Callable[[], int], dropped: Callable[[], int]
    ) -> None:
        """`parameters()`: learned parameters of the model now; `dropped()`: frame sets dropped so far."""
        super().__init__("status", bus, clock)
        self.sets = 0
        self._latency = latency
        self._parameters = parameters
        self._dropped = dropped
        self._seen: TwinState | None = None
        self._state: TwinState | None = None
        """That of the set before, or of this one: the newest that the model has followed."""
        self._forecast: Forecast | None = None
        self._drift: DriftReport | None = None
        self._newest: dict[str, Any] = {}
        self._sizes: list[int] = []
        self._next = 0

    @property
    def bytes_per_frame(self) -> float:
        """Mean size on the wire of what is published with a set, bytes; NaN before the first status."""
        return float(np.mean(self._sizes)) if self._sizes else float("nan")

    def on_configure(self) -> None:
        self.bus.subscribe(DRIFT, self._on_drift)
        self.bus.subscribe(SEEN, self._on_seen)
        self.bus.subscribe(STATE, self._on_state)
        for topic in PER_SET:
            self.bus.subscribe(topic, partial(self._newest.__setitem__, topic))
        self.bus.subscribe(FORECAST, self._on_forecast)

    def _on_seen(self, state: TwinState) -> None:
        self.sets += 1
        self._seen = state

    def _on_state(self, state: TwinState) -> None:
        self._state = state

    def _on_forecast(self, forecast: Forecast) -> None:
        self._forecast = forecast
        if self._seen is not None:
            self._tell(self._seen.stamp)

    def _on_drift(self, report: DriftReport) -> None:
        """Where no camera may be used no forecast comes, and its status neither: why is said nevertheless."""
        self._drift = report
        if len(report.distrusted) == len(report.drifts):
            self._tell(report.stamp)

    def _tell(self, stamp: int) -> None:
        """Publishes the status where it is due at a stamp."""
        seen, forecast = self._seen, self._forecast
        if seen is None or forecast is None or stamp < self._next:
            return
        model = self._state or seen
        self._next = stamp + PERIOD_NS
        if len(self._newest) == len(PER_SET):
            self._sizes.append(sum(len(serialize(message)) for message in self._newest.values()))
        status = convert.Status(
            stamp=seen.stamp,
            tier_counts=tuple(np.bincount(model.gaussians.tiers, minlength=len(Tier)).tolist()),
            parameters=self._parameters(),
            sets=self.sets,
            dropped=self._dropped(),
            bytes_per_frame=self.bytes_per_frame,
            latency_p50_ms=self._latency.percentile_ms(50),
            latency_p95_ms=self._latency.percentile_ms(95),
            latency_p99_ms=self._latency.percentile_ms(99),
            coverage=forecast.quality.coverage,
            coverage_target=forecast.quality.target,
            cameras=tuple(view.camera.name for view in seen.frames.views[: len(seen.exposures)]),
            exposures=tuple(exposure.brightness for exposure in seen.exposures),
            warnings=(
                *(self._drift.warnings if self._drift else ()),
                *self._latency.warnings,
                *model.warnings,
                *forecast.quality.warnings,
            ),
        )
        self.bus.publish(STATUS, convert.status_to_message(status))
