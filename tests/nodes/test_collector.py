"""What the report is told of each set, whichever of them the model has followed, and whenever."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from twin_node.forecast import ForecastQuality
from twin_node.messages import convert
from twin_node.nodes.collector import CollectorNode
from twin_node.nodes.forecast import Forecast
from twin_node.nodes.spool import Spool
from twin_node.nodes.topics import FORECAST, FRAMES, SEEN, SEPARATION, STATE, TRUSTED_FRAMES
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import FrameSet, GaussianCloud, NodeStates, Separation, Tier, TwinState

QUALITY = ForecastQuality(1.0, 0.99, 0.0, 1.0, np.ones(6) / 6)


def cloud(count: int) -> GaussianCloud:
    """So many STATIC Gaussians, by which clouds are told apart."""
    three, four = (np.zeros((count, width), np.float32) for width in (3, 4))
    one, ids = np.zeros(count, np.float32), np.arange(count, dtype=np.uint32)
    tiers = np.full(count, Tier.STATIC, np.uint8)
    return GaussianCloud(three, four, three, one, three, three, tiers, ids, np.full(count, -1, np.int32))


class Cell:
    """A bus with a collector, on which sets are told of."""

    def __init__(self, spool: Spool | None, rate: float | None = None) -> None:
        self.bus = LocalBus()
        self.spool = spool
        self.clock = SteppedClock()
        self.collector = CollectorNode(self.bus, self.clock, spool, rate)
        self.collector.configure()
        self.collector.activate()

    def see(self, stamp: int, followed: int) -> TwinState:
        """A set goes through the chain while the newest cloud follows another; a cloud has as many as its stamp."""
        frames = FrameSet(stamp, (), sequence=stamp)
        state = TwinState(stamp, frames, cloud(followed), NodeStates.none(), (), (), followed=followed)
        decision = Separation.without_pair(stamp, stamp, 1.0, "clear")
        for topic, message in (
            *((FRAMES, frames), (TRUSTED_FRAMES, frames), (SEEN, state)),
            (FORECAST, Forecast(None, None, QUALITY)),
            (SEPARATION, convert.separation_to_message(decision)),
        ):
            self.bus.publish(topic, message)
        return state

    def follow(self, seen: TwinState) -> None:
        """The model has followed it."""
        self.bus.publish(STATE, replace(seen, gaussians=cloud(seen.stamp), followed=None))

    def shown(self) -> list[tuple[int, int, int]]:
        """Of each set that is kept: its stamp, that of the set its cloud follows, and as many Gaussians as that has."""
        kept = [(tick.stamp, tick.state) for tick in self.spool]
        return [(stamp, state.model_stamp, len(state.gaussians.ids)) for stamp, state in kept if state is not None]


@pytest.fixture
def cell() -> Iterator[Cell]:
    with Spool(0, 1_000_000_000, 30.0) as spool:
        yield Cell(spool)


def test_a_set_is_kept_with_the_newest_that_was_followed_up_to_it(cell: Cell) -> None:
    seen = {1: cell.see(1, 0)}
    cell.follow(seen[1])
    assert cell.shown() == [(1, 1, 1)]
    for stamp in (2, 3, 4):
        seen[stamp] = cell.see(stamp, 1)
    assert cell.shown() == [(1, 1, 1)], "the model may follow any of them yet"
    cell.follow(seen[2])
    cell.follow(seen[4])
    assert cell.shown() == [(1, 1, 1), (2, 2, 2), (3, 2, 2), (4, 4, 4)]
    cell.see(5, 4)
    cell.collector.end()
    assert cell.shown()[4:] == [(5, 4, 4)]
    assert [sum(counts) for counts in cell.collector.tier_counts] == [1, 2, 2, 4, 4]
    assert cell.collector.stamps == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("rate", [1.0, None])
def test_a_set_is_kept_with_the_time_at_which_its_cloud_was_out(rate: float | None) -> None:
    with Spool(0, 1_000_000_000, 30.0) as spool:
        cell = Cell(spool, rate)
        seen = {1: cell.see(1, 0)}
        cell.clock.advance_to(10)
        cell.follow(seen[1])
        for stamp in (11, 12):
            seen[stamp] = cell.see(stamp, 1)
        cell.clock.advance_to(20)
        cell.follow(seen[12])
        cell.see(21, 12)
        cell.clock.advance_to(30)
        cell.collector.end()
        assert [tick.stamp for tick in spool] == [1, 11, 12, 21]
        assert [tick.published for tick in spool] == ([None] * 4 if rate is None else [10, 10, 20, 20])


@pytest.mark.parametrize("rate", [1.0, 0.25])
def test_latencies_are_told_in_real_time_whatever_the_pace_of_the_log(rate: float) -> None:
    cell = Cell(None, rate)
    cell.clock.advance_to(50_000_000)
    cell.see(30_000_000, 0)
    assert cell.collector.latencies_ms == [20.0 / rate]
