"""Whether the controller lives: its own clock must advance, whatever the connection claims."""

from __future__ import annotations


class Freshness:
    """Watches a controller's clock. `ur_rtde` repeats the last values for as long as the link is silent."""

    def __init__(self, now: int) -> None:
        """`now` (ns) is when the watch begins."""
        self._clock_s: float | None = None
        self._advanced = now
        self.has_gone_back = False
        """Whether the clock was ever found behind where it had been: the controller began anew."""

    def see(self, clock_s: float, now: int) -> bool:
        """Take the controller's clock (s) at a time (ns); True where it has advanced: the values beside it are new."""
        if self._clock_s is not None and clock_s < self._clock_s:
            self.has_gone_back = True
        if self._clock_s is None or clock_s > self._clock_s:
            self._clock_s, self._advanced = clock_s, now
            return True
        return False

    def age_s(self, now: int) -> float:
        """Time since the clock last advanced, s."""
        return (now - self._advanced) * 1e-9
