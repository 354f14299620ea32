"""Real-time priority, where the operating system grants it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


def ask_for_realtime(priority: int, process: int = 0) -> bool:
    """Let a process, and what it starts from now on, run before all ordinary ones (SCHED_FIFO, 1 to 99).

    `process` is its id; 0 is the calling thread. False where that is not permitted: it takes root, CAP_SYS_NICE or an
    `rtprio` limit. What runs so must sleep often.
    """
    try:
        os.sched_setscheduler(process, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError):
        return False  # not permitted, or no Linux: periods are kept as well as a busy computer lets us
    return True


@contextmanager
def realtime(priority: int) -> Iterator[bool]:
    """The calling thread runs so within, where that is permitted, and what it starts there does not."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (OSError, AttributeError):
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, *before)
