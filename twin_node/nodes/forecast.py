"""The forecast node: what images show in, occupancy up to 200 ms ahead and obstacles out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from twin_node.forecast import CoverParameters, Forecaster, ForecastQuality, cover
from twin_node.messages import convert
from twin_node.nodes.latency import Latency
from twin_node.nodes.topics import FORECAST, OBSTACLES, OCCUPANCY, SEEN
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.image_threads import image_loops_alone
from twin_node.runtime.node import Node
from twin_node.scene import Obstacles, Occupancy, TwinState


@dataclass(frozen=True)
class Forecast:
    """What the forecaster said of one state."""

    occupancy: Occupancy
    obstacles: Obstacles
    quality: ForecastQuality


class ForecastNode(Node):
    """Forecasts each set as of the time it will be read: from what it shows, before the model has followed it."""

    def __init__(
        self,
        bus: Bus,
        clock: Clock,
        make_forecaster: Callable[[], Forecaster],
        cover_parameters: CoverParameters,
        latency: Latency,
        dropped: Callable[[], int] = lambda: 0,
    ) -> None:
        """`dropped()`: frame sets dropped so far, see `Latency.add`."""
        super().__init__("forecast", bus, clock)
        self._make_forecaster = make_forecaster
        self.forecaster = make_forecaster()
        self._cover_parameters = cover_parameters
        self._latency = latency
        self._dropped = dropped
        self._anew_from: int | None = None
        self._obstacles: Obstacles | None = None

    def on_configure(self) -> None:
        image_loops_alone()
        self.bus.subscribe(SEEN, self._on_seen)

    def begin_anew(self, stamp: int) -> None:
        """States from this stamp (ns) on are another model's: of its nodes nothing that was learnt holds."""
        self._anew_from = stamp

    def _on_seen(self, state: TwinState) -> None:
        if self._anew_from is not None and state.stamp >= self._anew_from:
            self._anew_from, self.forecaster = None, self._make_forecaster()
        begun = self.clock.now()
        found = self.forecaster.update(state, state.stamp + self._latency.bridged_ns(state.stamp, begun))
        self._obstacles = cover(
            found.occupancy, self._obstacles, self._cover_parameters, found.motion, found.hidden, found.sighted
        )
        self.bus.publish(FORECAST, Forecast(found.occupancy, self._obstacles, self.forecaster.quality))
        self.bus.publish(OCCUPANCY, convert.occupancy_to_message(found.occupancy))
        self.bus.publish(OBSTACLES, convert.obstacles_to_message(self._obstacles))
        self._latency.add(state.stamp, begun, self.clock.now(), self._dropped())
