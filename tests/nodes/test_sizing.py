"""A live twin takes the largest size that keeps its budget here; what is fixed stays fixed."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.forecast import Forecaster, ForecastParameters, default_grid
from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.nodes import sizing
from twin_node.nodes.chain import Chain
from twin_node.nodes.chain_parameters import ChainParameters, load_parameters, sized
from twin_node.nodes.latency import Latency
from twin_node.nodes.model import Following, ModelNode
from twin_node.nodes.sizes import SHIPPED, SIZES, SizeChoice, SizeParameters
from twin_node.nodes.sizing import TRIED_SETS, Trial, best_within, median_ms, while_people_work
from twin_node.nodes.topics import STATE, TRUSTED_FRAMES
from twin_node.robot import ur_model
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.runtime.parameters import ParameterError, fill
from twin_node.scene import Camera, FrameSet, JointSample, TwinState, View

GRID = default_grid(np.array([[0.0, 0.0, 0.5], [0.4, 0.4, 0.9]]), 0.1)
MODEL = ModelParameters(seed=SeedParameters(steps=1))
SPENT = dict(zip(SIZES, (10.0, 20.0, 30.0, 45.0, 90.0), strict=True))


def frames(index: int, width: int = 100) -> FrameSet:
    """A grey image of a camera that stays the same."""
    image = np.full((width * 3 // 4, width, 3), 90, np.uint8)
    return FrameSet(index, (View(CAMERAS[width], index, image),), sequence=index)


CAMERAS = {width: Camera("one", width, width * 3 // 4, np.diag([width, width, 1.0]), np.eye(4)) for width in (48, 100)}


@pytest.mark.parametrize(("budget_ms", "chosen"), [(1000, "full"), (60, "large"), (30, "small"), (1, "tiny")])
def test_the_largest_within_a_budget_is_taken_from_the_smallest_up(budget_ms: float, chosen: str) -> None:
    """A fifth of the budget is spare; what lies beyond the first that is too slow is not tried."""
    tried: list[str] = []

    def timed_ms(name: str) -> float:
        tried.append(name)
        return SPENT[name]

    choice = best_within(budget_ms, tuple(SIZES), timed_ms)
    assert choice.size == chosen
    assert f"size {chosen}: {SPENT[chosen]:.0f} ms per set here" in choice.reason
    names = list(SIZES)
    assert tried == names[: min(names.index(chosen) + (1 if budget_ms == 1 else 2), len(names))]


def test_one_set_tells_nothing() -> None:
    assert median_ms([frames(0)], WindowModel(MODEL), Forecaster(GRID, ForecastParameters(), None)) is None


def trial(said: list[str], budget_ms: float = 60, kept: Path | None = None) -> Trial:
    return Trial(MODEL, ForecastParameters(), None, GRID, budget_ms, said.append, kept=kept)


def test_a_trial_measures_sizes_on_the_first_sets_and_says_what_it_took() -> None:
    said: list[str] = []
    one = trial(said, budget_ms=1e6)
    *before, found = [one.take(frames(index)) for index in range(TRIED_SETS)]
    assert before == [None] * (TRIED_SETS - 1)
    assert found is not None
    assert found.model.parameters == SIZES["small"].model(MODEL), "images of 100 pixels are too narrow for medium"
    assert found.narrower.narrowed(frames(20)).views[0].camera.width == SIZES["small"].width
    assert found.model.update(found.narrower.narrowed(frames(20))).stamp == 20, "it goes on from the trial's sets"
    assert len(said) == 1 and said[0].startswith("size small: ")


def test_a_model_that_took_the_arm_for_ground_begins_anew_after_the_trial() -> None:
    """A driver tells of its joints later than the cameras show it: where it had stood things moved for good."""
    arm, q = ur_model("ur5e"), np.zeros(6)
    told = JointSample(0, arm.joint_names, q, q)
    for joints, goes_on in ((None, False), (told, True)):
        one = Trial(MODEL, ForecastParameters(), arm, GRID, 1e6, lambda _: None)
        *_, found = [one.take(replace(frames(index), joints=joints)) for index in range(TRIED_SETS)]
        assert found is not None
        assert found.model.parameters == SIZES["small"].model(MODEL)
        assert (found.model.parameters_count > 0) is goes_on


def test_what_others_take_of_the_processor_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """A launch starts up meanwhile: the same machine had sizes from tiny to large, by who was loading just then."""
    said: list[str] = []
    monkeypatch.setattr(sizing.time, "thread_time", lambda: 0.0)
    one = trial(said, budget_ms=1e-6)
    for index in range(TRIED_SETS):
        one.take(frames(index))
    assert said == ["size small: 0 ms per set here, the best within 1e-06 ms"]


@pytest.mark.parametrize(("moving", "times"), [(0, 1.9), (30, 1.45), (60, 1.0), (600, 1.0)])
def test_sets_in_which_nothing_moves_yet_count_as_if_people_worked(moving: int, times: float) -> None:
    """A launch took `large` before anybody had come, and with them an arm did half of what it does with `small`."""
    mask = np.zeros((30, 40), np.bool_)
    mask.flat[:moving] = True
    state = WindowModel(MODEL).look(frames(0, 48))
    assert while_people_work(replace(state, moving_masks=(mask,))) == pytest.approx(times)


def test_a_trial_counts_what_sets_will_take_once_people_work(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    ticks = itertools.count()
    monkeypatch.setattr(sizing.time, "thread_time", lambda: 0.010 * next(ticks))
    one = trial(said)
    for index in range(TRIED_SETS):
        one.take(frames(index))
    assert said == ["size small: 19 ms per set here, the best within 60 ms"]


def test_a_trial_ends_when_its_twin_is_to_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C waited for all sizes, and a launcher kills what takes longer than five seconds."""
    said: list[str] = []
    followed: list[int] = []
    update = WindowModel.update
    monkeypatch.setattr(WindowModel, "update", lambda self, one: followed.append(one.stamp) or update(self, one))
    one = Trial(MODEL, ForecastParameters(), None, GRID, 1e6, said.append, lambda: len(followed) == 3)
    assert [one.take(frames(index)) for index in range(TRIED_SETS)] == [None] * TRIED_SETS
    assert followed == [0, 1, 2]
    assert not said


def test_a_twin_that_takes_the_place_of_another_goes_on_with_its_size_at_once(tmp_path: Path) -> None:
    """Five seconds passed until the arm heard of people again, of which the trial took three."""
    said: list[str] = []
    one = trial([], 1e6, tmp_path)
    for index in range(TRIED_SETS):
        one.take(frames(index))
    found = trial(said, 1e-6, tmp_path).take(frames(0))
    assert found is not None
    assert found.model.parameters == SIZES["small"].model(MODEL)
    assert found.narrower.narrowed(frames(20)).views[0].camera.width == SIZES["small"].width
    assert said == ["size small, as it was found before"]


def test_a_chain_is_made_with_the_size_that_the_one_before_it_found(tmp_path: Path) -> None:
    (tmp_path / sizing.FILE).write_text("tiny")
    said: list[str] = []
    chain = fill(ChainParameters, {"size": {"name": "auto"}, "model": {"seed": {"steps": 1}}}, "here")
    bus, clock, volume = LocalBus(), SteppedClock(), np.array([[0.0, 0.0, 0.5], [0.4, 0.4, 0.9]])
    node = Chain(bus, clock, volume, chain, Latency(0, False), say=said.append, kept=tmp_path).model_node
    node.configure()
    node.activate()
    bus.publish(TRUSTED_FRAMES, frames(0))
    assert said == ["size tiny, as it was found before"]
    assert node.model.parameters == SIZES["tiny"].model(chain.model)


@pytest.mark.parametrize("left", [b"", b"sma", b"\xff\xfe", None])
def test_a_size_that_was_not_left_whole_is_found_anew(left: bytes | None, tmp_path: Path) -> None:
    if left is None:
        (tmp_path / sizing.FILE).mkdir()
    else:
        (tmp_path / sizing.FILE).write_bytes(left)
    said: list[str] = []
    one = trial(said, 1e6, tmp_path)
    for index in range(TRIED_SETS):
        one.take(frames(index))
    assert [line[:11] for line in said] == ["size small:"]
    assert left is None or (tmp_path / sizing.FILE).read_text() == "small"


@pytest.mark.parametrize(("width", "tried"), [(48, ["tiny"]), (100, ["tiny", "small"])])
def test_sizes_wider_than_the_images_are_not_tried(width: int, tried: list[str]) -> None:
    said: list[str] = []
    one = trial(said, budget_ms=1e6)
    for index in range(TRIED_SETS):
        one.take(frames(index, width))
    assert said[0].startswith(f"size {tried[-1]}: ")


def test_the_model_begins_when_its_size_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sizing, "TRIED_SETS", 2)
    bus, states = LocalBus(), list[TwinState]()
    node = ModelNode(bus, SteppedClock(), WindowModel(MODEL), trial=trial([], budget_ms=1e-6))
    bus.subscribe(STATE, states.append)
    node.configure()
    node.activate()
    for index in range(4):
        bus.publish(TRUSTED_FRAMES, frames(index))
        node.work_between_sets()
    assert [state.stamp for state in states] == [2, 3]
    assert states[0].frames.views[0].camera.width == SIZES["tiny"].width
    assert states[0].frames.views[0].camera is states[1].frames.views[0].camera
    assert node.model.parameters == SIZES["tiny"].model(MODEL)


def test_the_models_process_is_begun_once_its_size_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []

    class Loading:
        has_model = False

        def __init__(self) -> None:
            begun.append(index)

        def is_loaded(self) -> bool:
            return False

        def result(self, wait: bool) -> None:
            return None

    monkeypatch.setattr(sizing, "TRIED_SETS", 2)
    monkeypatch.setattr("twin_node.nodes.model.ModelProcess", Loading)
    monkeypatch.setattr("twin_node.nodes.model.is_worth_it", lambda: True)
    bus, one = LocalBus(), trial([], budget_ms=1e-6)
    node = ModelNode(bus, SteppedClock(), WindowModel(MODEL), Following.APART, one)
    node.configure()
    node.activate()
    for index in range(4):
        bus.publish(TRUSTED_FRAMES, frames(index))
        node.work_between_sets()
    assert begun == [1], "sizes are not timed beside what loads"


def test_a_size_that_is_named_is_taken_as_it_is() -> None:
    chain = fill(ChainParameters, {"size": {"name": "small"}}, "here")
    changed = sized(chain, "here")
    assert changed.synchronizer.width == SIZES["small"].width
    assert changed.model == SIZES["small"].model(chain.model)


@pytest.mark.parametrize("choice", [SizeChoice.GIVEN, SizeChoice.AUTO])
def test_what_is_not_launched_stays_as_it_is_given(choice: SizeChoice) -> None:
    chain = ChainParameters(size=SizeParameters(choice))
    assert sized(chain, "here") == chain


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("gaussians_per_pixel", 0.7),
        ("most_gaussians", 7),
        ("track.steps", 7),
        ("birth.per_set", 7),
        ("birth.moving_share", 0.7),
    ],
)
def test_a_size_beside_what_it_decides_is_refused_by_its_name(key: str, value: float) -> None:
    section, _, last = key.rpartition(".")
    model = {section: {last: value}} if section else {last: value}
    mixed = fill(ChainParameters, {"size": {"name": "tiny"}, "model": model}, "here")
    with pytest.raises(ParameterError, match=rf"here: size: name: tiny: expected the model's .*\b{re.escape(key)}\b"):
        sized(mixed, "here")


def test_a_size_that_there_is_none_of_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"expected one of given, auto, tiny.*found 'huge'"):
        fill(ChainParameters, {"size": {"name": "huge"}}, "here")


@pytest.mark.parametrize("budget", ["0", "-5.0"])
def test_a_budget_that_nothing_keeps_is_refused(budget: str, tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text(f"size: {{ros__parameters: {{name: auto, budget_ms: {budget}}}}}\n")
    with pytest.raises(ParameterError, match=r"size: budget_ms: expected a number above 0, found"):
        load_parameters(path)


def test_every_size_can_be_named() -> None:
    assert [one.value for one in SizeChoice] == ["given", "auto", *SIZES]
    assert SHIPPED in SIZES
