"""The model node refines what stands still after it has published, and where time is short only now and then."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.nodes.model import BUDGET_NS, MOST_LEFT, ModelNode
from twin_node.nodes.topics import STATE, TRUSTED_FRAMES
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import Camera, FrameSet, TwinState, View

K = np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]])


def frames(index: int) -> FrameSet:
    """A grey image."""
    view = View(Camera("one", 32, 24, K, np.eye(4)), index, np.full((24, 32, 3), 90, np.uint8))
    return FrameSet(index, (view,), sequence=index)


class Watched(WindowModel):
    """A model whose updates take as long as the test says, and that notes what is done after them."""

    def __init__(self, wait: Callable[[], None]) -> None:
        super().__init__(ModelParameters(seed=SeedParameters(steps=1)))
        self.wait = wait
        self.done: list[str] = []

    def update(self, frames: FrameSet) -> TwinState:
        state = super().update(frames)
        self.wait()
        return state

    def refine(self) -> None:
        self.done.append("refine")

    def leave(self) -> None:
        self.done.append("leave")


@pytest.mark.parametrize(
    ("cost_ns", "expected"),
    [(0, ["refine"] * 8), (2 * BUDGET_NS, (["leave"] * (MOST_LEFT - 1) + ["refine"]) * 2)],
)
def test_what_stands_still_is_refined_where_there_is_time(cost_ns: int, expected: list[str]) -> None:
    clock, bus = SteppedClock(), LocalBus()
    model = Watched(lambda: clock.advance_to(clock.now() + cost_ns))
    node = ModelNode(bus, clock, model)
    node.configure()
    node.activate()
    order: list[str] = []
    bus.subscribe(STATE, lambda state: order.append(f"{state.stamp} published after {len(model.done)}"))
    for index in range(8):
        bus.publish(TRUSTED_FRAMES, frames(index))
        node.rest()
    assert model.done == expected
    assert order == [f"{index} published after {index}" for index in range(8)]
