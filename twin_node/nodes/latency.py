"""How long evidence is under way: measured when live, assumed in lockstep."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

ASSUMED_LATENCY_NS = 33_000_000
"""From evidence to publication in lockstep, and before it was measured: one frame at 30 Hz."""
MEMORY_NS = 10_000_000_000
"""Percentiles are taken over what came in so long, ns: a set held up long ago says nothing of the next."""
FEWEST = 30
"""Latencies below which what is assumed is bridged at least."""
LONGEST_BRIDGED_NS = 400_000_000
"""No forecast begins later after its evidence: by then an arm stands (`arm.LimiterParameters`). One set that was held
up, or a clock that was set while it was under way, would have all that moves forecast to be minutes away."""


class Latency:
    """How long evidence has been under way of late, from its stamp to publication, and what forecasts take of that."""

    def __init__(self, assumed_ns: int, is_measured: bool) -> None:
        """`assumed_ns` is bridged until enough was measured, and for ever where `is_measured` is False."""
        self._assumed_ns = assumed_ns
        self.is_measured = is_measured
        self._is_started = False
        self._samples: deque[_Sample] = deque()

    def start(self) -> None:
        """Measure from now on: what came before was start-up."""
        self._is_started = True

    def add(self, stamp: int, begun: int, published: int) -> None:
        """Count a forecast of evidence of `stamp`, that was `begun` and `published` then (ns, one clock).

        Ignored where latency is assumed, because lockstep knows no time.
        """
        if not self.is_measured or not self._is_started:
            return
        if self._samples and published < self._samples[-1].published:
            self._samples.clear()  # the clock was set back: nothing would be old enough to be forgotten
        self._samples.append(_Sample(published, published - stamp, published - begun))
        while len(self._samples) > FEWEST and self._samples[0].published < published - MEMORY_NS:
            self._samples.popleft()

    def bridged_ns(self, stamp: int, now: int) -> int:
        """What a forecast of evidence of `stamp` that is begun `now` (ns) must bridge to be valid when it is read, ns.

        That is what has passed, which differs from set to set and is known, and the p99 of what a forecast takes from
        there. At most `LONGEST_BRIDGED_NS`, and 0 at least: cameras' clocks may be ahead.
        """
        if not self.is_measured or not self._is_started:
            return self._assumed_ns
        passed = now - stamp
        if len(self._samples) < FEWEST:
            return max(min(passed, LONGEST_BRIDGED_NS), self._assumed_ns)
        taken = np.percentile([sample.taken for sample in self._samples], 99)
        return min(max(passed + int(taken), 0), LONGEST_BRIDGED_NS)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know: where half of all forecasts come too late, an arm never moves."""
        if len(self._samples) < FEWEST or self.percentile_ms(50) <= LONGEST_BRIDGED_NS / 1e6:
            return ()
        return (
            f"latency: forecasts come {self.percentile_ms(50):.0f} ms after their images' stamps, and an arm stands "
            f"for what is older than {LONGEST_BRIDGED_NS / 1e6:.0f} ms; set the cameras' clocks if they are behind, "
            "else choose a smaller size or image width, or a faster machine",
        )

    def percentile_ms(self, percent: float) -> float:
        """A percentile of the measured latencies, ms; NaN without samples."""
        if not self._samples:
            return float("nan")
        return float(np.percentile([sample.latency for sample in self._samples], percent)) / 1e6


class _Sample(NamedTuple):
    """A forecast that was published; all in ns."""

    published: int
    latency: int
    """Since its evidence."""
    taken: int
    """Since it was begun."""
