"""When the next message of a stream is due, and whether to leave the one that waits for it."""

from __future__ import annotations

import statistics
from collections import deque

PATIENCE = 0.5
"""Share of the time between messages that one which waits is left for the next: that one is younger when the work on it
is done. With work that takes longer than the time between messages, latency falls by a third of that time on average
and by half of it at worst; a twelfth of the messages or less is paid."""
LATE = 0.25
"""What is overdue by this share of the time between messages is not waited for any longer."""
GAPS = 8
"""Times between messages that tell when the next is due: a quarter of a second at 30 Hz."""


class Arrivals:
    """The arrivals of one stream's messages, in seconds of one clock."""

    def __init__(self, patience: float) -> None:
        """`patience`: see `PATIENCE`; with 0 nothing is ever left."""
        self._patience = patience
        self._gaps: deque[float] = deque(maxlen=GAPS)
        self._last: float | None = None

    def add(self, now: float) -> None:
        """A message has come."""
        if self._last is not None:
            self._gaps.append(now - self._last)
        self._last = now

    def worth_waiting_s(self, now: float) -> float:
        """How long to wait at most for a newer message than the last; 0 where that is not worth it."""
        if self._last is None or len(self._gaps) < GAPS or not self._patience:
            return 0.0
        gap = statistics.median(self._gaps)
        due_in = self._last + gap - now
        return max(due_in + LATE * gap, 0.0) if due_in < self._patience * gap else 0.0
