"""The model node refines what stands still after it has published, and passes on how much time there is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.stages import Proceed, unhurried
from twin_node.nodes.model import ModelNode
from twin_node.nodes.topics import STATE, TRUSTED_FRAMES
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import Camera, FrameSet, View

K = np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]])


def frames(index: int) -> FrameSet:
    """A grey image."""
    view = View(Camera("one", 32, 24, K, np.eye(4)), index, np.full((24, 32, 3), 90, np.uint8))
    return FrameSet(index, (view,), sequence=index)


class Watched(WindowModel):
    """A model that notes what is done after its updates."""

    def __init__(self) -> None:
        super().__init__(ModelParameters(seed=SeedParameters(steps=1)))
        self.done: list[str] = []

    def refine(self, proceed: Proceed = unhurried) -> bool:
        whole = proceed()
        self.done.append("refine" if whole else "leave")
        return whole


@pytest.mark.parametrize(("waits", "expected"), [(False, ["refine"] * 8), (True, ["leave"] * 8)])
def test_what_stands_still_is_refined_where_no_set_waits(waits: bool, expected: list[str]) -> None:
    bus, model = LocalBus(), Watched()
    node = ModelNode(bus, SteppedClock(), model)
    node.configure()
    node.activate()
    order: list[str] = []
    bus.subscribe(STATE, lambda state: order.append(f"{state.stamp} published after {len(model.done)}"))
    for index in range(8):
        bus.publish(TRUSTED_FRAMES, frames(index))
        node.rest(lambda: not waits)
    assert model.done == expected
    assert order == [f"{index} published after {index}" for index in range(8)]


def test_a_configured_node_keeps_opencv_to_one_thread() -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        ModelNode(LocalBus(), SteppedClock(), Watched()).configure()
        assert cv2.getNumThreads() == 1
    finally:
        cv2.setNumThreads(before)
