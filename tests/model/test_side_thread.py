"""Work that another thread does meanwhile is done once, whoever does it."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from model_scenes import rig, sliding

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.side_thread import SideThread
from twin_node.native_library import kernel_threads


@pytest.mark.parametrize("threads", [1, 2])
def test_work_is_done_once_by_its_end(threads: int) -> None:
    done: list[int] = []
    with kernel_threads(threads):
        begun = SideThread().begin(lambda: done.append(threading.get_ident()))
        begun.end()
    assert len(done) == 1
    assert threads == 2 or done == [threading.get_ident()]


def test_work_that_nobody_has_begun_is_done_by_who_asks() -> None:
    aside, gate, done = SideThread(), threading.Event(), []
    with kernel_threads(2):
        first = aside.begin(lambda: done.append(gate.wait()))
        second = aside.begin(lambda: done.append(threading.get_ident()))
        second.end()
        assert done == [threading.get_ident()]
        gate.set()
        first.end()
    assert len(done) == 2


@pytest.mark.parametrize("threads", [1, 2])
def test_what_work_raises_is_raised_at_its_end(threads: int) -> None:
    with kernel_threads(threads):
        begun = SideThread().begin(lambda: np.zeros(1)[[2]])
        with pytest.raises(IndexError):
            begun.end()


def test_one_thread_and_two_learn_the_same() -> None:
    clouds = []
    for threads in (1, 2):
        model = WindowModel(ModelParameters(seed=SeedParameters(steps=20)))
        with kernel_threads(threads):
            for one in sliding(12, rig()):
                state = model.update(one)
        clouds.append(state.gaussians)
    assert clouds[0].means.tobytes() == clouds[1].means.tobytes()
    assert clouds[0].rgb.tobytes() == clouds[1].rgb.tobytes()
