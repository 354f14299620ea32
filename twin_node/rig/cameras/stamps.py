"""Capture times on this host's clock, from clocks that run beside it: never ahead of now, always rising."""

from __future__ import annotations

import time
from collections.abc import Callable

LEAST_STEP_NS = 1
"""By how much a stamp that would not rise is put after the one before."""
RESET_NS = 500_000_000
"""A clock that is further off than this has been set anew: it is followed, not clamped."""


class CaptureStamps:
    """Turns one camera's steady times into stamps.

    Host stamps of depthai can run slightly ahead of the host's own clock and go back by microseconds
    (luxonis/depthai-core issue 742), which synchronisers take for faults.
    """

    def __init__(self, wall: Callable[[], int] = time.time_ns, steady: Callable[[], int] = time.monotonic_ns) -> None:
        self._wall = wall
        self._steady = steady
        self._last: int | None = None
        self.clamped = 0
        """Stamps that had to be changed."""

    def of_steady(self, capture: int) -> int:
        """Stamp of a capture at `capture` on the steady clock, ns."""
        now = self._wall()
        return self._admitted(now - (self._steady() - capture), now)

    def of_arrival(self, latency: int) -> int:
        """Stamp of an image that has just come, captured `latency` ns ago."""
        now = self._wall()
        return self._admitted(now - latency, now)

    def _admitted(self, stamp: int, now: int) -> int:
        kept = min(stamp, now)
        last = self._last
        if last is not None and last - RESET_NS < kept <= last:
            kept = last + LEAST_STEP_NS
        self.clamped += kept != stamp
        self._last = kept
        return kept
