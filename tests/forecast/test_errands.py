"""Errands are done once, by whoever comes first."""

from __future__ import annotations

import threading

import pytest
import torch

from twin_node.forecast.errands import Errand, Helper, _helper


class Work:
    """Counts how often it was done, and by whom."""

    def __init__(self) -> None:
        self.done_by: list[int] = []
        self.begun = threading.Event()

    def __call__(self) -> int:
        self.done_by.append(threading.get_ident())
        self.begun.set()
        return 7


@pytest.fixture(autouse=True)
def two_threads() -> object:
    """The errand's helper is asked only where there may be one."""
    before = torch.get_num_threads()
    _helper.cache_clear()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_a_helper_does_it() -> None:
    work = Work()
    errand = Errand(work)
    assert work.begun.wait(60)
    assert [errand.result(), errand.result()] == [7, 7]
    assert len(work.done_by) == 1
    assert work.done_by[0] != threading.get_ident()


def test_who_asks_does_it_where_the_helper_has_not_begun() -> None:
    gate, work = threading.Event(), Work()
    busy = Errand(lambda: gate.wait(60))
    errand = Errand(work)
    assert [errand.result(), errand.result()] == [7, 7]
    assert work.done_by == [threading.get_ident()]
    gate.set()
    assert busy.result()


def test_it_is_done_here_where_there_is_one_thread() -> None:
    torch.set_num_threads(1)
    work = Work()
    errand = Errand(work)
    assert work.done_by == [threading.get_ident()]
    assert errand.result() == 7


@pytest.mark.parametrize("threads", [1, 2])
def test_what_the_work_raises_is_raised_where_it_is_asked_for(threads: int) -> None:
    torch.set_num_threads(threads)

    def fails() -> None:
        raise ValueError("nothing there")

    errand = Errand(fails)
    with pytest.raises(ValueError, match="nothing there"):
        errand.result()


def test_a_helper_that_keeps_others_waiting_is_left_alone_for_longer_each_time() -> None:
    helper = Helper()
    assert not helper.is_dismissed()
    helper.judge(0.1)
    assert [helper.is_dismissed() for _ in range(9)] == [True] * 8 + [False]
    helper.judge(0.1)
    assert [helper.is_dismissed() for _ in range(25)] == [True] * 24 + [False]
    helper.judge(0.0)
    assert not helper.is_dismissed()
