"""What the twin says of itself: once a second, of the newest set, with all that anybody warns of."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from twin_node.forecast import ForecastQuality
from twin_node.messages import convert, serialize
from twin_node.nodes.forecast import Forecast
from twin_node.nodes.latency import FEWEST, Latency
from twin_node.nodes.status import PER_SET, PERIOD_NS, StatusNode
from twin_node.nodes.topics import DRIFT, FORECAST, SEEN, STATE, STATUS
from twin_node.rig.drift_report import Drift, DriftReport, Verdict
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import Camera, Exposure, FrameSet, GaussianCloud, NodeStates, Tier, TwinState, View

START, SET_NS = 10**9, 100_000_000
CAMERAS = [Camera(name, 2, 2, np.eye(3), np.eye(4)) for name in ("left", "right")]
GRAY = np.zeros((2, 2, 3), np.uint8)


def state(stamp: int, gaussians: int, warnings: tuple[str, ...] = ()) -> TwinState:
    """A state of two cameras, the second half as bright, with so many RIGID Gaussians."""
    frames = FrameSet(stamp, tuple(View(camera, stamp, GRAY) for camera in CAMERAS))
    cloud = GaussianCloud.none()
    tiers = np.full(gaussians, int(Tier.RIGID), np.uint8)
    exposures = tuple(Exposure(np.full(3, gain, np.float32), np.zeros(3, np.float32)) for gain in (1.0, 0.5))
    none = (np.zeros((2, 2), bool),) * 2
    return TwinState(
        stamp, frames, replace(cloud, tiers=tiers), NodeStates.none(), none, (None, None), warnings, exposures
    )


def forecast(coverage: float, warnings: tuple[str, ...] = ()) -> Forecast:
    """One of which the status tells how good it is."""
    quality = ForecastQuality(coverage, 0.95, 0.0, 1.0, np.zeros(6), warnings)
    return Forecast(None, None, quality)  # type: ignore[arg-type]


@dataclass
class Watched:
    """A status node and what it has said."""

    latency: Latency = field(default_factory=lambda: Latency(0, is_measured=True))
    bus: LocalBus = field(default_factory=LocalBus)
    said: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.node = StatusNode(self.bus, SteppedClock(START), self.latency, lambda: 7, lambda: 3)
        self.node.on_configure()
        self.bus.subscribe(STATUS, lambda message: self.said.append(convert.status_from_message(message)))

    def show(self, seen: TwinState, coverage: float = 1.0, warnings: tuple[str, ...] = ()) -> None:
        """A set that is seen and forecast."""
        self.bus.publish(SEEN, seen)
        self.bus.publish(FORECAST, forecast(coverage, warnings))


def test_it_comes_once_a_second_and_is_of_the_newest_set() -> None:
    watched = Watched()
    for index in range(25):
        watched.show(state(START + index * SET_NS, 5), coverage=0.01 * index)
    assert [status.stamp for status in watched.said] == [START, START + PERIOD_NS, START + 2 * PERIOD_NS]
    assert [status.sets for status in watched.said] == [1, 11, 21]
    assert [status.coverage for status in watched.said] == pytest.approx([0.0, 0.1, 0.2])
    last = watched.said[-1]
    assert (last.parameters, last.dropped, last.coverage_target) == (7, 3, pytest.approx(0.95))
    assert (last.cameras, last.exposures) == (("left", "right"), pytest.approx((1.0, 0.5)))


def test_gaussians_are_counted_of_the_set_that_the_model_has_followed() -> None:
    watched = Watched()
    watched.show(state(START, 2))
    watched.bus.publish(STATE, state(START, 5))
    watched.show(state(START + PERIOD_NS, 2))
    assert [status.tier_counts[Tier.RIGID] for status in watched.said] == [2, 5]
    assert all(len(status.tier_counts) == len(Tier) for status in watched.said)


def test_all_that_anybody_warns_of_is_said() -> None:
    """Half of all forecasts come after half a second, a camera has moved, and model and forecast have their say."""
    watched = Watched()
    watched.latency.start()
    for _ in range(FEWEST):
        watched.latency.add(0, 460_000_000, 500_000_000)
    drifts = (Drift("left", Verdict.BUMPED, 9.0, 1.0, 40, START), Drift("right", Verdict.STEADY, 0.1, 0.0, 40, START))
    watched.bus.publish(DRIFT, DriftReport(START, drifts))
    watched.bus.publish(STATE, state(START, 0, ("the model",)))
    watched.show(state(START, 0), warnings=("the forecast",))
    warnings = watched.said[0].warnings
    for part in ("camera left has moved", "latency: forecasts come 500 ms", "the model", "the forecast"):
        assert sum(part in warning for warning in warnings) == 1
    assert watched.said[0].latency_p50_ms == pytest.approx(500)


def test_what_goes_over_the_wire_with_a_set_is_measured() -> None:
    watched = Watched()
    message = convert.status_to_message(convert.Status(START, (), 0, 0, 0))
    watched.show(state(START, 0))
    for topic in PER_SET:
        watched.bus.publish(topic, message)
    watched.show(state(START + PERIOD_NS, 0))
    assert np.isnan(watched.said[0].bytes_per_frame)
    assert watched.said[1].bytes_per_frame == len(PER_SET) * len(serialize(message))
