"""Capture times on this host's clock, from clocks that run beside it: not ahead of now, rising, at a likely pace."""

from __future__ import annotations

import time
from collections.abc import Callable

from twin_node.runtime.clock import SystemClock

LEAST_STEP_NS = 1
"""By how much a stamp that would not rise is put after the one before."""
RESET_NS = SystemClock.LEAST_JUMP_NS
"""A clock that is further off than this has been set anew: it is followed, not clamped, as by all that asks for now.
Synchronisers take images that are ahead of now by no more."""


class CaptureStamps:
    """Turns one camera's steady times into stamps.

    Host stamps of depthai can run slightly ahead of the host's own clock and go back by microseconds
    (luxonis/depthai-core issue 742), which synchronisers take for faults. Where the host's clock is put back by less
    than `RESET_NS`, now goes on at half its pace until the clock has caught up: images that stood still in time would
    show motion without end.
    """

    def __init__(self, wall: Callable[[], int] = time.time_ns, steady: Callable[[], int] = time.monotonic_ns) -> None:
        self._wall = wall
        self._steady = steady
        self._now: int | None = None
        self._now_at = 0
        """On the steady clock."""
        self._last: int | None = None

    def of_steady(self, capture: int) -> int:
        """Stamp of a capture at `capture` on the steady clock, ns."""
        steady = self._steady()
        return self._admitted(steady - capture, steady)

    def of_arrival(self, latency: int) -> int:
        """Stamp of an image that has just come, captured `latency` ns ago."""
        return self._admitted(latency, self._steady())

    def _admitted(self, age: int, steady: int) -> int:
        wall = self._wall()
        now = self._followed(wall, steady)
        kept = min(now - age, now)
        last = self._last
        if last is not None and last - RESET_NS < kept <= last:
            kept = last + LEAST_STEP_NS
        self._last = kept
        return kept

    def _followed(self, wall: int, steady: int) -> int:
        """Now: the wall clock's time, or what has not yet been caught up with after it was put back."""
        now = wall
        if self._now is not None:
            passed = max(steady - self._now_at, 0)
            if self._now + passed - wall <= RESET_NS:
                now = max(wall, self._now + passed // 2)
            else:
                self._last = None  # stamps go back with the clock
        self._now, self._now_at = now, steady
        return now
