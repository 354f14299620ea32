"""Whether the controller lives: its own clock must advance, whatever the connection claims."""

from __future__ import annotations


class Freshness:
    """Watches a controller's clock. `ur_rtde` repeats the last values for as long as the link is silent.

    Only time in which the clock was looked at counts: a driver that a busy computer held up knows nothing of the
    controller meanwhile, and its first look finds what was received before.
    """

    def __init__(self, now: int, longest_look_ns: int) -> None:
        """`now` (ns) is when the watch begins; between two looks no more than `longest_look_ns` is counted."""
        self._longest_look_ns = longest_look_ns
        self._clock_s: float | None = None
        self._looked = now
        self._silent_ns = 0
        self.has_gone_back = False
        """Whether the clock was ever found behind where it had been: the controller began anew."""

    def see(self, clock_s: float, now: int) -> bool:
        """Take the controller's clock (s) at a time (ns); True where it has advanced: the values beside it are new."""
        if self._clock_s is not None and clock_s < self._clock_s:
            self.has_gone_back = True
        self._silent_ns += min(now - self._looked, self._longest_look_ns)
        self._looked = now
        if self._clock_s is None or clock_s > self._clock_s:
            self._clock_s, self._silent_ns = clock_s, 0
            return True
        return False

    @property
    def age_s(self) -> float:
        """Time without an advance, s, up to the last look."""
        return self._silent_ns * 1e-9
