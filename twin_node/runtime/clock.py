"""Clocks in integer nanoseconds: the log's own time, paced or stepped."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Where nodes get the time from."""

    def now(self) -> int:
        """Time, ns."""


class SteppedClock:
    """Stands where it was last put: time in lockstep is the stamp of the newest message."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now = start_ns

    def now(self) -> int:
        """Time it was last put to, ns."""
        return self._now

    def advance_to(self, stamp: int) -> None:
        """Put the clock to `stamp`; never back."""
        self._now = max(self._now, stamp)


class PacedClock:
    """The log's time running at `rate` times the speed of the wall clock; it stands until it is started."""

    def __init__(self, start_ns: int, rate: float) -> None:
        self._start_ns = start_ns
        self._rate = rate
        self._wall_start_ns: int | None = None

    def start(self) -> None:
        """Let time run from now on."""
        self._wall_start_ns = time.monotonic_ns()

    def now(self) -> int:
        """Log time, ns."""
        if self._wall_start_ns is None:
            return self._start_ns
        return self._start_ns + int((time.monotonic_ns() - self._wall_start_ns) * self._rate)

    def seconds_until(self, stamp: int) -> float:
        """Wall seconds until log time `stamp` once the clock runs; negative when it has passed."""
        return (stamp - self.now()) / (1e9 * self._rate)
