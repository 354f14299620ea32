"""Enter, at the terminal that a command was started in."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Iterator

LOOKS_S = 0.2
"""How often `lines` looks whose keys they are, s."""


def enter_pressed() -> bool:
    """Whether Enter has been pressed since the last call, for this command; False where there is no terminal."""
    return sys.stdin.isatty() and _is_ours() and _waits(0.0) and bool(sys.stdin.readline())


def lines() -> Iterator[str]:
    """What is typed for this command, line by line, as long as there is somebody to type."""
    while True:
        if not _is_ours():
            time.sleep(LOOKS_S)
        elif _waits(LOOKS_S):
            line = sys.stdin.readline()
            if not line:
                return
            yield line


def _is_ours() -> bool:
    """Whether keys are for this command: one in the background (`&`) that reads them is stopped by the system."""
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # a terminal that was not started from: nobody else reads there
        return True


def _waits(for_s: float) -> bool:
    """Whether a line is there, or comes within a time, s."""
    return bool(select.select([sys.stdin], [], [], for_s)[0])
