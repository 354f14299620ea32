"""Clocks in integer nanoseconds: the log's own time, paced or stepped."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol


class Clock(Protocol):
    """Where nodes get the time from."""

    def now(self) -> int:
        """Time, ns."""


LOOKS = 3
"""At a clock and the monotonic one, of which the shortest is taken: a process may be held up between the two."""


def ahead_of_monotonic(clock: Clock) -> int:
    """By how much a clock is ahead of CLOCK_MONOTONIC, ns."""
    looks = []
    for _ in range(LOOKS):
        before = time.monotonic_ns()
        now = clock.now()
        after = time.monotonic_ns()
        looks.append((after - before, now - (before + after) // 2))
    return min(looks)[1]


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


class SystemClock:
    """The time of day, as cameras of a live rig stamp their images."""

    LEAST_JUMP_NS = 100_000_000
    """A clock that is put back by more has jumped: what has less to catch up with does so by itself."""

    def __init__(self, on_jump_back: Callable[[], None] = lambda: None) -> None:
        """`on_jump_back()` is called, by whoever asks for the time first, when somebody has put the clock back."""
        self._on_jump_back = on_jump_back
        self._ahead: int | None = None
        self._lock = threading.Lock()

    def now(self) -> int:
        """Time since 1970, ns."""
        with self._lock:
            before = time.monotonic_ns()
            now = time.time_ns()
            after = time.monotonic_ns()
            is_back = self._ahead is not None and now - before < self._ahead - self.LEAST_JUMP_NS
            self._ahead = now - after  # at least: a look that was held up in between is no jump
        if is_back:
            self._on_jump_back()
        return now


class FollowedClock:
    """Time as `/clock` tells it (ROS's `use_sim_time`), carried on between its messages at the pace they show."""

    LONGEST_STEP_NS = 100_000_000
    """Time stands when no message came for as long as this: a paused log is not carried on."""
    KEPT = 9
    """Messages that tell the pace: of two alone, one of which was held up, time would run ahead by as much as above."""
    LEAST_JUMP_NS = 1_000_000_000
    """What is told so much later than the pace lets expect is of another part of the log: its pace is learnt anew."""

    def __init__(self, on_jump_back: Callable[[], None] = lambda: None) -> None:
        """`on_jump_back()` is called when time goes back: a log has begun again."""
        self._on_jump_back = on_jump_back
        self._told_ns = 0
        self._told_at = time.monotonic_ns()
        self._told: deque[tuple[int, int]] = deque(maxlen=self.KEPT)
        self._rate = 0.0
        self._shown = 0
        self._lock = threading.Lock()

    def set(self, stamp: int) -> None:
        """Takes what `/clock` says, ns."""
        with self._lock:
            is_back = self._take(stamp, time.monotonic_ns())
        if is_back:
            self._on_jump_back()

    def now(self) -> int:
        """Time, ns; 0 before the first message. It never goes back but when `/clock` does."""
        with self._lock:
            since = time.monotonic_ns() - self._told_at
            ahead = min(int(since * self._rate), self.LONGEST_STEP_NS)
            self._shown = max(self._shown, self._told_ns + max(ahead, 0))
            return self._shown

    def _take(self, stamp: int, at: int) -> bool:
        """Takes a stamp, ns, told at a time of the monotonic clock, ns; gives back whether time goes back."""
        is_back = stamp < self._told_ns
        expected = self._told_ns + (at - self._told_at) * self._rate
        if is_back or (self._rate and stamp > expected + self.LEAST_JUMP_NS):
            self._told.clear()
        self._told.append((stamp, at))
        first_stamp, first_at = self._told[0]
        if at > first_at:
            self._rate = (stamp - first_stamp) / (at - first_at)
        self._told_ns, self._told_at = stamp, at
        if is_back:
            self._shown = stamp
        return is_back
