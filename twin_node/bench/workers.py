"""Processes that the runs of a bench are spread over."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def _nothing() -> None:
    """All that most workers begin with."""


@contextmanager
def workers(count: int, begin: Callable[[], None] = _nothing, fresh: bool = False) -> Iterator[ProcessPoolExecutor]:
    """A pool of `count` processes, each of which calls `begin` first; `fresh`: a new one for every run.

    They are spawned, as nothing may fork after OpenMP has started, and end with the process that began them, however it
    ends. Where the body raises, as at an interrupt, runs that have begun are given up.
    """
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        count,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin,
        initargs=(begin,),
        max_tasks_per_child=1 if fresh else None,
    )
    try:
        yield pool
    except BaseException:
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)  # waits: a pool that still shuts down as Python ends may raise there


def spread(
    work: Callable[[Job], Result], jobs: Sequence[Job], count: int, begin: Callable[[], None] = _nothing
) -> Iterator[Result]:
    """What comes of jobs, in their order, worked on by `count` processes as `workers` has them; by this one, where one
    is enough."""
    count = min(count, len(jobs))
    if count <= 1:
        yield from map(work, jobs)
        return
    with workers(count, begin) as pool:
        yield from pool.map(work, jobs)


def _begin(begin: Callable[[], None]) -> None:
    """An interrupt is for the process that began this one, which tells what becomes of the run."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    begin()


def _end_with_parent() -> None:
    """A pool's workers wait for work for ever, for each of them holds the pipe that it comes by open itself."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
