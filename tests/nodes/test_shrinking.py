"""A twin whose sets take too long goes on with a smaller model, where its size is its own to choose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.forecast import Forecaster, ForecastParameters, default_grid
from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.nodes import sizing
from twin_node.nodes.chain import Chain
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.latency import OFTEN, SETTLED_NS, SLOWS_NS, Latency
from twin_node.nodes.model import Following, ModelNode
from twin_node.nodes.sizes import SIZES
from twin_node.nodes.sizing import FILE, TRIED_SETS, Trial
from twin_node.nodes.topics import FORECAST, GAUSSIANS, SEEN, STATE, TRUSTED_FRAMES
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.runtime.parameters import fill
from twin_node.scene import Camera, FrameSet, JointSample, TwinState, View

VOLUME = np.array([[0.0, 0.0, 0.5], [0.4, 0.4, 0.9]])
MODEL = ModelParameters(seed=SeedParameters(steps=1))
CAMERA = Camera("one", 100, 75, np.diag([100.0, 100.0, 1.0]), np.eye(4))
PERIOD_NS = 100_000_000


def frames(index: int, depth: bool = True, bright: bool = False, level: int = 90) -> FrameSet:
    """A grey image, in which half of what is seen may become bright."""
    image = np.full((75, 100, 3), level, np.uint8)
    if bright:
        image[:, :50] = 200
    there = np.full((75, 100), 0.8, np.float32) if depth else None
    stamp = index * PERIOD_NS
    return FrameSet(stamp, (View(CAMERA, stamp, image, there),), sequence=index)


def trial(said: list[str], kept: Path | None = None) -> Trial:
    return Trial(
        MODEL, ForecastParameters(), None, default_grid(VOLUME, 0.1), 1e6, said.append, kept=kept
    )  # everything keeps such a budget


class Shrinking:
    """A model node whose trial is over, and what came of it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, depth: bool = True) -> None:
        monkeypatch.setattr(sizing, "TRIED_SETS", 2)
        self.said: list[str] = []
        self.came: list[str] = []
        self.states: list[TwinState] = []
        self.is_too_slow = False
        self._depth, self._index, self._bus = depth, 0, LocalBus()
        self.node = ModelNode(
            *(self._bus, SteppedClock(), WindowModel(MODEL), Following.IN_TIME, trial(self.said)),
            is_too_slow=lambda: self.is_too_slow,
            on_anew=lambda stamp: self.came.append(f"anew from {stamp // PERIOD_NS}"),
        )
        self._bus.subscribe(SEEN, lambda state: self.came.append(f"seen {state.frames.views[0].camera.width}"))
        self._bus.subscribe(STATE, self.states.append)
        self._bus.subscribe(GAUSSIANS, lambda _: self.came.append("whole"))
        self.node.configure()
        self.node.activate()
        self.take(2)

    def take(self, sets: int, bright: bool = False, level: int = 90, joints: JointSample | None = None) -> list[str]:
        """What came of the next sets."""
        self.came.clear()
        for _ in range(sets):
            shown = frames(self._index, self._depth, bright, level)
            self._bus.publish(TRUSTED_FRAMES, replace(shown, joints=joints))
            self.node.work_between_sets()
            self._index += 1
        return self.came.copy()


def test_a_twin_that_is_too_slow_begins_anew_with_the_next_smaller_size(monkeypatch: pytest.MonkeyPatch) -> None:
    one = Shrinking(monkeypatch)
    assert one.take(2) == ["seen 96", "whole", "seen 96"]
    one.is_too_slow = True
    assert one.take(1) == ["anew from 4", "seen 64", "whole"], "who has the cloud of before gets a whole one at once"
    one.is_too_slow = False
    assert one.take(1) == ["seen 64"]
    assert one.node.model.parameters == SIZES["tiny"].model(MODEL)
    assert one.said[1:] == ["size tiny: with small forecasts came too late for an arm again and again"]
    assert [state.frames.views[0].camera.width for state in one.states] == [96, 96, 64, 64]


def test_the_smallest_goes_on_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    one = Shrinking(monkeypatch)
    one.is_too_slow = True
    assert one.take(4) == ["seen 96", "whole", "anew from 3", "seen 64", "whole", "seen 64", "seen 64"]
    assert len(one.said) == 2


def test_without_depth_it_waits_until_nothing_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever moves just then would be ground, and their place free."""
    one = Shrinking(monkeypatch, depth=False)
    one.take(1)
    one.take(1, bright=True)
    one.is_too_slow = True
    assert one.take(2, bright=True) == ["seen 96", "seen 96"]
    assert one.take(1) == ["seen 96"]
    assert one.take(1) == ["anew from 7", "seen 64", "whole"]


def test_it_waits_until_the_arms_joints_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The arm would be ground, which moves on."""
    one = Shrinking(monkeypatch)
    joints = JointSample(0, ("one",), np.zeros(1), np.zeros(1))
    one.take(1, joints=joints)
    one.is_too_slow = True
    assert one.take(2) == ["seen 96", "seen 96"]
    assert one.take(1, joints=joints) == ["anew from 5", "seen 64", "whole"]


def test_a_smaller_model_does_not_begin_in_the_dark(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its first set would be the scene at rest."""
    one = Shrinking(monkeypatch)
    one.take(1)
    one.is_too_slow = True
    assert one.take(1, level=0) == ["anew from 3"]
    one.is_too_slow = False
    assert one.take(1, level=0) == []
    assert one.take(1) == ["seen 64", "whole"]


def test_a_twin_whose_size_is_given_stays_as_it_is() -> None:
    bus, anew = LocalBus(), list[int]()
    node = ModelNode(
        *(bus, SteppedClock(), WindowModel(MODEL), Following.IN_TIME),
        is_too_slow=lambda: True,
        on_anew=anew.append,
    )
    node.configure()
    node.activate()
    for index in range(3):
        bus.publish(TRUSTED_FRAMES, frames(index))
        node.work_between_sets()
    assert anew == []
    assert node.model.parameters == MODEL


def test_the_twin_that_takes_its_place_has_the_smaller_size(tmp_path: Path) -> None:
    one = trial([], tmp_path)
    for index in range(TRIED_SETS):
        one.take(frames(index))
    assert (tmp_path / FILE).read_text() == "small"
    assert one.smaller() is not None
    assert (tmp_path / FILE).read_text() == "tiny"
    assert one.smaller() is None
    found = trial([], tmp_path)
    assert found.take(frames(0)) is not None
    assert found.smaller() is None, "the size that was left behind is the smallest"


def test_a_chain_shrinks_when_its_forecasts_come_too_late(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its forecaster begins anew with the model: nodes of one are none of the other's."""
    monkeypatch.setattr(sizing, "TRIED_SETS", 2)
    said: list[str] = []
    parameters = fill(
        ChainParameters, {"size": {"name": "auto", "budget_ms": 1e6}, "model": {"seed": {"steps": 1}}}, ""
    )
    bus, clock, latency, dropped = LocalBus(), SteppedClock(), Latency(0, is_measured=True), iter(range(10_000))
    chain = Chain(*(bus, clock, VOLUME, parameters, latency), dropped=lambda: next(dropped), say=said.append)
    seen: list[int] = []
    by: list[tuple[int, Forecaster]] = []
    bus.subscribe(SEEN, lambda state: seen.append(state.frames.views[0].camera.width))
    bus.subscribe(FORECAST, lambda _: by.append((seen[-1], chain.forecaster)))
    latency.start()
    chain.start()
    sets = 5 + (SETTLED_NS // PERIOD_NS)
    for index in range(sets):
        late_ns = SLOWS_NS if index > sets - 2 * OFTEN else PERIOD_NS
        clock.advance_to(index * PERIOD_NS + late_ns)
        bus.publish(TRUSTED_FRAMES, frames(index))
        chain.model_node.work_between_sets()
    assert set(seen) == {96, 64}
    assert [width for width in seen if width == 64] == seen[seen.index(64) :], "there is no way back"
    assert (
        len({width for width, _ in by}) == len({id(one) for _, one in by}) == len({(w, id(one)) for w, one in by}) == 2
    )
    assert len(said) == 2
    assert latency.slowed == 0
    chain.stop()
