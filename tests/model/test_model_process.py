"""A model that goes on in another process is the one that it would have been."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import pytest
from model_scenes import BLOCK_SPEED, rig, sliding

from twin_node.model import ModelError, ModelParameters, SeedParameters, WindowModel
from twin_node.model.model_process import LOOK_S, PATIENCE_S, Followed, ModelProcess
from twin_node.model.model_worker import serve
from twin_node.model.stages import LeftS, endless, granted
from twin_node.runtime.copies import receive, send
from twin_node.runtime.worker_process import EndedError, Failed
from twin_node.scene import FrameSet, GaussianCloud, NodeStates, TwinState

SETS = 16
WAIT_S = 60.0
HANDED_OVER = 8
PARAMETERS = ModelParameters(seed=SeedParameters(steps=20))


def anew(state: TwinState) -> TwinState:
    """As another process gets it: nothing of it is what it was."""
    return pickle.loads(pickle.dumps(state))


def hurried_model() -> tuple[WindowModel, int]:
    """A model that has followed some sets live, and after how many of them it was not left the time for all."""
    model, unfinished = WindowModel(PARAMETERS), 0
    for index, one in enumerate(sliding(SETS, rig())[:HANDED_OVER]):
        since = time.perf_counter()
        model.follow(model.look(one), lambda since=since: 0.033 - (time.perf_counter() - since))
        unfinished += not model.refine(granted(1 + index % 4))
    return model, unfinished


def test_a_copy_goes_on_as_the_model_does() -> None:
    model, unfinished = hurried_model()
    assert unfinished > 1
    copy = pickle.loads(pickle.dumps(model))
    for one in sliding(SETS, rig())[HANDED_OVER:]:
        seen = model.look(one)
        theirs, ours = copy.follow(anew(seen)), model.follow(seen)
        for record in ("gaussians", "nodes"):
            for name, values in vars(getattr(ours, record)).items():
                assert values.tobytes() == vars(getattr(theirs, record))[name].tobytes(), name
        assert copy.refine() == model.refine()
    assert len(ours.nodes.ids), "something moves"
    assert copy.parameters_count == model.parameters_count


def test_it_can_be_handed_over_after_any_slice() -> None:
    model, whole = WindowModel(PARAMETERS), 0
    for index, one in enumerate(sliding(SETS, rig())):
        model.update(one)
        whole += model.refine(granted(index % 5))
        pickle.dumps(model)
    assert 0 < whole < SETS


@pytest.fixture
def process() -> Iterator[ModelProcess]:
    """A process without a model."""
    one = ModelProcess()
    yield one
    one.close()


def test_a_process_follows_what_is_seen_here(process: ModelProcess) -> None:
    model, sets = WindowModel(PARAMETERS), sliding(SETS, rig())
    model.update(sets[0])
    assert not process.is_free
    assert process.is_loaded(wait=True)
    process.take(model)
    assert process.is_free
    assert process.parameters_count == model.parameters_count
    assert process.result() is None
    for one in sets[1:]:
        seen = model.look(one)
        process.follow(seen)
        assert not process.is_free
        state = process.result(WAIT_S)
        assert state is not None
        assert (state.stamp, state.model_stamp) == (one.stamp, one.stamp)
        assert state.frames is seen.frames
        model.hear_of(state)
    assert state.nodes.velocities[:, 0].max() > BLOCK_SPEED / 3
    later = model.look(sets[-1])
    assert (later.model_stamp, len(later.gaussians.means)) == (sets[-1].stamp, len(state.gaussians.means))
    assert process.parameters_count > 14 * len(state.gaussians.means)
    assert 50 < process.peak_rss_mb < 2000


def test_another_model_takes_the_place_of_the_one_before(process: ModelProcess) -> None:
    """Also while a set is followed by that one: nobody wants to know what becomes of it."""
    cameras, small = rig(), rig(width=40, height=30)
    model, sets = WindowModel(PARAMETERS), sliding(SETS, cameras)
    model.update(sets[0])
    assert process.is_loaded(wait=True)
    process.take(model)
    process.follow(model.look(sets[1]))
    process.let_go()
    assert not process.has_model and not process.is_free
    other, narrow = WindowModel(PARAMETERS), sliding(SETS, small)
    other.update(narrow[0])
    process.take(other)
    assert process.is_free
    for one in narrow[1:3]:
        process.follow(other.look(one))
        state = process.result(WAIT_S)
        assert state is not None
        assert state.stamp == one.stamp
        assert len(state.gaussians.means) < other.parameters.most_gaussians
        other.hear_of(state)
    assert process.parameters_count == 14 * len(state.gaussians.means)


def test_a_process_that_dies_is_told_of(process: ModelProcess) -> None:
    assert process.is_loaded(wait=True)
    os.kill(process.pid, signal.SIGKILL)
    with pytest.raises(EndedError, match=r"process \(\d+\) .* ended with status -9; .*own_process"):
        while True:  # what it does not take may fit into the pipe
            process.take(_first())


def test_a_process_that_hangs_is_ended_and_told_of(process: ModelProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    os.kill(process.pid, signal.SIGSTOP)  # it will never even have loaded
    process.follow(TwinState(1, FrameSet(1, ()), GaussianCloud.none(), NodeStates.none(), (), ()))
    now = [time.monotonic()]
    monkeypatch.setattr("twin_node.model.model_process.time", SimpleNamespace(monotonic=lambda: now[0]))
    now[0] += 2 * PATIENCE_S
    assert process.result() is None, "whoever looks so seldom was stopped as well"
    with pytest.raises(EndedError, match=r"process \(\d+\) to go on, found that it hangs, and ended it; .*own_process"):
        for _ in range(round(PATIENCE_S / LOOK_S) + 1):
            now[0] += LOOK_S
            process.result()
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


def test_a_process_ends_with_who_began_it(process: ModelProcess) -> None:
    process.close()
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


class Stubborn(WindowModel):
    """A model that refuses the second set, and fails of the third."""

    def follow(self, seen: TwinState, left_s: LeftS = endless) -> TwinState:
        if seen.frames.sequence == 1:
            raise ModelError("set 1: expected another; give that")
        if seen.frames.sequence == 2:
            raise ValueError("a fault of its own")
        return super().follow(seen)


def test_a_set_that_is_refused_costs_no_more_than_itself() -> None:
    ours, its = multiprocessing.Pipe()
    thread = threading.Thread(target=serve, args=(its,), daemon=True)
    thread.start()
    model = Stubborn(ModelParameters(seed=SeedParameters(steps=1)))
    sets = sliding(4, rig())
    model.update(sets[0])
    send(ours, model)
    answers = []
    for one in (sets[1], sets[3], sets[2]):
        send(ours, model.look(replace(one, stamp=sets[3].stamp)))
        answers.append(receive(ours))
    thread.join(10)
    assert not thread.is_alive(), "a fault ends it"
    refused, followed, failed = answers
    assert isinstance(refused, Failed) and str(refused.error) == "set 1: expected another; give that"
    assert isinstance(followed, Followed) and len(followed.gaussians.means)
    assert isinstance(failed, Failed) and "ValueError: a fault of its own" in str(failed.error)


def _first() -> WindowModel:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=1)))
    model.update(sliding(1, rig())[0])
    return model
