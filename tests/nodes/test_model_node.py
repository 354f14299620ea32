"""The model node refines what stands still after it has published, and passes on how much time there is."""

from __future__ import annotations

import copy
import gc
import math
import weakref
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from twin_node.model import ModelParameters, SeedParameters, TrackParameters, WindowModel
from twin_node.model.stages import LeftS, Proceed, endless, unhurried
from twin_node.nodes.model import Following, ModelNode
from twin_node.nodes.topics import SEEN, STATE, TRUSTED_FRAMES
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import Camera, FrameSet, TwinState, View

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
        node.follow()
        node.work_between_sets(lambda: not waits)
    assert model.done == expected
    assert order == [f"{index} published after {index}" for index in range(8)]


def test_a_model_whose_node_has_ended_is_let_go() -> None:
    """A launched twin begins anew whenever time jumps back: each of its models stayed, 115 MB of them."""
    bus, model = LocalBus(), Watched()
    node = ModelNode(bus, SteppedClock(), model)
    node.configure()
    node.activate()
    bus.publish(TRUSTED_FRAMES, frames(0))
    node.follow()
    node.deactivate()
    node.cleanup()
    known = weakref.ref(model)
    del node, model, bus
    gc.collect()
    assert known() is None


def test_where_sets_wait_every_other_one_is_followed() -> None:
    bus, model = LocalBus(), Watched()
    node = ModelNode(bus, SteppedClock(), model)
    node.configure()
    node.activate()
    seen: list[int] = []
    followed: list[int] = []
    bus.subscribe(SEEN, lambda state: seen.append(state.stamp))
    bus.subscribe(STATE, lambda state: followed.append(state.stamp))
    for index in range(8):
        bus.publish(TRUSTED_FRAMES, frames(index))
        node.work_between_sets(lambda: False)
    assert seen == list(range(8))
    assert followed == [1, 3, 5, 7]
    assert node.followed == 4
    for index in range(8, 12):
        bus.publish(TRUSTED_FRAMES, frames(index))
        node.work_between_sets(lambda: True)
    assert followed[4:] == [8, 9, 10, 11]


def test_a_live_set_does_not_wait_until_the_one_before_is_followed() -> None:
    bus, model = LocalBus(), Watched()
    node = ModelNode(bus, SteppedClock(), model, Following.IN_TIME)
    node.configure()
    node.activate()
    told: list[tuple[str, int]] = []
    for topic in (SEEN, STATE):
        bus.subscribe(topic, lambda state, topic=topic: told.append((topic, state.stamp)))
    for index in range(3):
        bus.publish(TRUSTED_FRAMES, frames(index))
    node.work_between_sets()
    assert told == [(SEEN, 0), (SEEN, 1), (SEEN, 2), (STATE, 2)]


def test_what_a_set_shows_is_out_before_the_model_follows_it() -> None:
    bus, model = LocalBus(), Watched()
    node = ModelNode(bus, SteppedClock(), model)
    node.configure()
    node.activate()
    told: list[tuple[str, int, int]] = []
    for topic in (SEEN, STATE):
        bus.subscribe(topic, lambda state, topic=topic: told.append((topic, state.stamp, state.model_stamp)))
    for index in range(2):
        bus.publish(TRUSTED_FRAMES, frames(index))
    bus.publish(TRUSTED_FRAMES, frames(2))
    assert told[-1] == (SEEN, 2, 1)
    node.follow()
    node.follow()
    node.work_between_sets()
    assert told == [(SEEN, 0, 0), (STATE, 0, 0), (SEEN, 1, 0), (STATE, 1, 1), (SEEN, 2, 1), (STATE, 2, 2)]
    assert model.done == ["refine"]


class Asked(Watched):
    """A model that notes how much time each set is left."""

    def __init__(self, latency_ms: float) -> None:
        super().__init__()
        self.parameters = replace(self.parameters, track=TrackParameters(latency_ms=latency_ms))
        self.left_s: list[float] = []

    def follow(self, seen: TwinState, left_s: LeftS = endless) -> TwinState:
        self.left_s.append(left_s())
        return super().follow(seen)


@pytest.mark.parametrize(
    ("is_live", "latency_ms", "expected"), [(True, 33.0, 0.033 - 0.010), (True, 0.0, math.inf), (False, 33.0, math.inf)]
)
def test_a_live_set_is_left_what_is_left_of_the_latency_wished_for(
    is_live: bool, latency_ms: float, expected: float
) -> None:
    bus, clock, model = LocalBus(), SteppedClock(), Asked(latency_ms)
    node = ModelNode(bus, clock, model, Following.IN_TIME if is_live else Following.IN_TURN)
    node.configure()
    node.activate()
    clock.advance_to(10_000_000)
    bus.publish(TRUSTED_FRAMES, frames(0))
    node.follow()
    assert model.left_s == [pytest.approx(expected)]


def test_a_configured_node_keeps_opencv_to_one_thread() -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        ModelNode(LocalBus(), SteppedClock(), Watched()).configure()
        assert cv2.getNumThreads() == 1
    finally:
        cv2.setNumThreads(before)


class InTurn:
    """Stands in for the process of a model: what it is handed is followed when it is asked to."""

    def __init__(self) -> None:
        self.loaded = self.has_model = self.is_closed = False
        self.parameters_count, self.peak_rss_mb = 0, 0.0
        self._seen: TwinState | None = None
        self._result: TwinState | None = None

    def is_loaded(self, wait: bool = False) -> bool:
        self.loaded |= wait
        return self.loaded

    def take(self, model: WindowModel) -> None:
        self.has_model, self._model = True, copy.deepcopy(model)
        self.parameters_count = self._model.parameters_count

    @property
    def is_free(self) -> bool:
        return self.has_model and self._seen is None and self._result is None

    def follow(self, seen: TwinState) -> None:
        assert self.is_free
        self._seen = seen

    def work(self) -> None:
        """Follows what it was handed."""
        assert self._seen is not None
        self._result, self._seen = self._model.follow(self._seen), None
        self.peak_rss_mb = 400.0

    def result(self, wait_s: float = 0.0) -> TwinState | None:
        if wait_s and self._seen is not None:
            self.work()
        result, self._result = self._result, None
        return result

    def close(self) -> None:
        self.is_closed = True


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> InTurn:
    """What a node takes for the process of its model."""
    one = InTurn()
    monkeypatch.setattr("twin_node.nodes.model.ModelProcess", lambda: one)
    monkeypatch.setattr("twin_node.nodes.model.is_worth_it", lambda: True)
    return one


def told_of(bus: LocalBus) -> list[tuple[str, int, int]]:
    """What goes out of each set: topic, stamp, and that of the set which the model follows."""
    told: list[tuple[str, int, int]] = []
    for topic in (SEEN, STATE):
        bus.subscribe(topic, lambda state, topic=topic: told.append((topic, state.stamp, state.model_stamp)))
    return told


@dataclass
class LiveNode:
    """A live node with a process of its own, and what goes out of it."""

    bus: LocalBus
    model: Watched
    node: ModelNode
    told: list[tuple[str, int, int]]

    def take(self, *indices: int) -> None:
        """Sends sets, and rests after each."""
        for index in indices:
            self.bus.publish(TRUSTED_FRAMES, frames(index))
            self.node.work_between_sets()


@pytest.fixture
def live(process: InTurn) -> LiveNode:
    """The process has not loaded yet."""
    bus, model = LocalBus(), Watched()
    node = ModelNode(bus, SteppedClock(), model, Following.APART)
    node.configure()
    node.activate()
    return LiveNode(bus, model, node, told_of(bus))


def test_another_process_is_given_the_model_once_it_has_loaded(process: InTurn, live: LiveNode) -> None:
    live.take(0, 1, 2)
    assert not process.has_model
    process.loaded = True
    live.take(3)
    assert process.has_model
    assert live.model.done == ["refine"] * 4
    assert live.told == [
        (topic, index, max(index - (topic == SEEN), 0)) for index in range(4) for topic in (SEEN, STATE)
    ]


def test_what_another_process_has_followed_goes_out_when_the_arm_has_been_told(process: InTurn, live: LiveNode) -> None:
    process.loaded = True
    live.take(0)
    live.told.clear()
    live.take(1, 2, 3)  # the process is not done with 1
    process.work()
    live.bus.publish(TRUSTED_FRAMES, frames(4))
    assert live.told == [(SEEN, 1, 0), (SEEN, 2, 0), (SEEN, 3, 0), (SEEN, 4, 1)]
    live.told.clear()
    live.node.work_between_sets()
    assert live.told == [(STATE, 1, 1)]
    assert live.node.parameters_count == process.parameters_count
    assert live.model.done == ["refine"], "the process does"


def test_what_another_process_follows_at_the_end_still_goes_out(process: InTurn, live: LiveNode) -> None:
    process.loaded = True
    live.take(0, 1)
    live.told.clear()
    live.node.deactivate()
    assert live.told == [(STATE, 1, 1)]
    assert live.node.followed == 2
    assert live.node.peak_rss_mb_elsewhere == 400.0
    assert not process.is_closed
    live.node.cleanup()
    assert process.is_closed


def test_who_settles_has_every_later_set_followed_elsewhere(process: InTurn) -> None:
    bus = LocalBus()
    node = ModelNode(bus, SteppedClock(), Watched(), Following.APART)
    node.configure()
    node.activate()
    node.await_process()
    assert not process.has_model, "there is no model before the first set"
    bus.publish(TRUSTED_FRAMES, frames(0))
    node.follow()
    node.await_process()
    assert process.has_model


@pytest.mark.parametrize(
    ("following", "is_worth_it"), [(Following.IN_TURN, True), (Following.IN_TIME, True), (Following.APART, False)]
)
def test_in_lockstep_or_without_another_processor_there_is_no_other_process(
    following: Following, is_worth_it: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[int] = []
    monkeypatch.setattr("twin_node.nodes.model.ModelProcess", lambda: begun.append(1))
    monkeypatch.setattr("twin_node.nodes.model.is_worth_it", lambda: is_worth_it)
    ModelNode(LocalBus(), SteppedClock(), Watched(), following).configure()
    assert not begun


def test_the_model_begins_with_the_first_set_that_shows_something() -> None:
    bus, model = LocalBus(), Watched()
    node = ModelNode(bus, SteppedClock(), model)
    node.configure()
    node.activate()
    seen: list[int] = []
    bus.subscribe(SEEN, lambda state: seen.append(state.stamp))
    for index in range(4):
        one = frames(index)
        dark = replace(one.views[0], rgb=np.zeros_like(one.views[0].rgb))
        bus.publish(TRUSTED_FRAMES, replace(one, views=(dark,)) if index in (0, 1, 3) else one)
        assert [diagnosis.name for diagnosis in node.diagnoses()] == (["model: light"] if index < 2 else [])
    assert seen == [2, 3], "a camera that has shown something may go dark"
