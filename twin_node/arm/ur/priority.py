"""Real-time priority, where the operating system grants it."""

from __future__ import annotations

import os


def ask_for_realtime(priority: int, process: int = 0, *, is_inherited: bool = True) -> bool:
    """Let a process, and threads that it starts from now on, run before all ordinary ones (SCHED_FIFO, 1 to 99).

    `process` is its id; 0 is the calling thread. What it starts runs so, too, if `is_inherited`. False where
    that is not permitted: it takes root, CAP_SYS_NICE or an `rtprio` limit. What runs so must sleep often.
    """
    try:
        policy = os.SCHED_FIFO if is_inherited else os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(process, policy, os.sched_param(priority))
    except (OSError, AttributeError):
        return False  # not permitted, or no Linux: periods are kept as well as a busy computer lets us
    return True
