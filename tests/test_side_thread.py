"""Tasks are done once, by whoever comes first."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from twin_node.native_library import kernel_threads
from twin_node.side_thread import SideThread


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
def two_threads() -> Iterator[None]:
    """The side thread is asked only where there may be one."""
    with kernel_threads(2):
        yield


def test_a_side_thread_does_it_once_it_has_entered() -> None:
    work, entered = Work(), Work()
    task = SideThread(entered).begin(work)
    assert work.begun.wait(60)
    assert [task.result(), task.result()] == [7, 7]
    assert work.done_by == entered.done_by != [threading.get_ident()]
    assert task.is_done


def test_who_asks_does_it_where_the_side_thread_has_not_begun() -> None:
    side_thread, gate, work = SideThread(), threading.Event(), Work()
    busy, task = side_thread.begin(gate.wait), side_thread.begin(work)
    assert not task.is_done
    assert [task.result(), task.result()] == [7, 7]
    assert work.done_by == [threading.get_ident()]
    gate.set()
    assert busy.result()


def test_who_asks_does_it_where_there_is_one_thread() -> None:
    work = Work()
    with kernel_threads(1):
        task = SideThread().begin(work)
        assert not work.done_by
        assert [task.result(), task.result()] == [7, 7]
    assert work.done_by == [threading.get_ident()]


@pytest.mark.parametrize("threads", [1, 2])
def test_what_the_work_raises_is_raised_where_it_is_asked_for(threads: int) -> None:
    with kernel_threads(threads):
        task = SideThread().begin(lambda: np.zeros(1)[[2]])
        for _ in range(2):
            with pytest.raises(IndexError):
                task.result()


def test_a_thread_that_keeps_others_waiting_is_left_alone_for_longer_each_time() -> None:
    side_thread = SideThread(patience_s=0.0)
    for alone in (8, 24):
        late = Work()
        task = side_thread.begin(late)
        assert late.begun.wait(60)
        task.result()
        works = [Work() for _ in range(alone + 1)]
        tasks = [side_thread.begin(work) for work in works]
        assert works[-1].begun.wait(60), "is not asked again"
        assert not any(work.done_by for work in works[:-1])
        assert [task.result() for task in tasks[:-1]] == [7] * alone


def test_a_copy_in_another_process_has_what_came_of_it_and_a_thread_of_its_own() -> None:
    task, side_thread = pickle.loads(pickle.dumps((SideThread().begin(Work()), SideThread(patience_s=1e-3))))
    assert task.result() == 7
    assert side_thread.begin(Work()).result() == 7
