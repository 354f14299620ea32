"""Clocks that are put back while messages are recorded by them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from twin_node.bag.recording import PUT_BACK_NS, free_path


class Arrival(NamedTuple):
    """When a message came."""

    stamp: int
    """ns."""
    put_back_ns: int
    """By how much the clock had been put back until then, in all."""


class Arrivals:
    """Follows a clock message by message, in the order in which they come, from whatever threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest = Arrival(0, 0)

    def at(self, stamp: int) -> Arrival:
        """A message comes at a time of the clock, ns."""
        with self._lock:
            back_ns = self._newest.stamp - stamp
            self._newest = Arrival(stamp, self._newest.put_back_ns + (back_ns if back_ns > PUT_BACK_NS else 0))
            return self._newest


class PutBackClock:
    """Tells where a recording is to go on beside the one before: in one log what comes then would stand in between."""

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        """`path`: as was asked for; others have its name with a number behind. `say(line)` tells the user of them."""
        self._path = path
        self._say = say
        self._put_back_ns = 0
        """By how much the clock had been put back until the recording of now was begun, in all."""

    def beside(self, came: Arrival) -> Path | None:
        """Path of the recording that is to be begun with a message; None: it belongs to the last.

        Messages may be written in another order than they came: of a topic whose oldest were lost while the disk stood
        still, those that are left are written before older ones of others.
        """
        back_ns = came.put_back_ns - self._put_back_ns
        if back_ns <= 0:
            return None
        self._put_back_ns = came.put_back_ns
        path = free_path(self._path)
        self._say(f"time was put back by {back_ns / 1e9:.1f} s: what comes from now on is recorded into {path}")
        return path
