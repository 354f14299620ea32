"""What need not be done in every set: done again where enough time has passed, however quickly sets come."""

from __future__ import annotations


class Throttle:
    """Says of one kind of work when it is due again."""

    def __init__(self, period_s: float) -> None:
        """`period_s`: from one time that it is done to the next at least."""
        self._period_ns = round(period_s * 1e9)
        self._done_at: int | None = None

    def is_due(self, stamp: int) -> bool:
        """Whether it is due with the set of `stamp` (ns); who asks does it then."""
        if self._done_at is not None and stamp - self._done_at < self._period_ns:
            return False
        self._done_at = stamp
        return True
