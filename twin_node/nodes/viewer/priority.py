"""Threads that let the twin go first."""

from __future__ import annotations

import os
import sys
import threading

NICENESS = 10
"""Of what works for visitors: a tenth of the processor time of an equal that wants it too (sched(7))."""


def go_last() -> None:
    """Lets every other thread go before this one and those that it starts from now on; on Linux, else nothing."""
    if sys.platform == "linux":
        thread = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, thread, max(os.getpriority(os.PRIO_PROCESS, thread), NICENESS))
