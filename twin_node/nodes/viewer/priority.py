"""Threads that let the twin go first."""

from __future__ import annotations

import os
import sys
import threading

NICENESS = 10
"""Of what works for visitors, beyond that of its process: a tenth of the processor time of its equals (sched(7))."""
LEAST = 19
"""The system's lowest priority."""


def go_last() -> None:
    """Lets every other thread go before this one and those that it starts from now on; on Linux, else nothing."""
    if sys.platform == "linux":
        thread = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, thread, min(os.getpriority(os.PRIO_PROCESS, thread) + NICENESS, LEAST))
