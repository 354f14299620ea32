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
SLOWS_NS = 300_000_000
"""An arm is slowed from this age of its evidence on (`arm.LimiterParameters`), and takes 0.6 s to be fast again."""
HELD_UP_NS = 60_000_000
"""A twin that keeps up with cameras is not so long from one forecast to the next: what makes images of its old is
somebody else's doing, and no smaller model's to mend."""
OFTEN = 5
"""An arm that had to slow down so often within `MEMORY_NS` is slow most of the time."""
SETTLED_NS = 15_000_000_000
"""What loads beside the first sets, and holds them up, has loaded by then."""


class Latency:
    """How long evidence has been under way of late, from its stamp to publication, and what forecasts take of that."""

    def __init__(self, assumed_ns: int, is_measured: bool) -> None:
        """`assumed_ns` is bridged until enough was measured, and for ever where `is_measured` is False."""
        self._assumed_ns = assumed_ns
        self.is_measured = is_measured
        self._is_started = False
        self._samples: deque[_Sample] = deque()
        self._counts_from: int | None = None
        """When the first of this model's forecasts was published, ns."""
        self._dropped = 0

    def start(self) -> None:
        """Measure from now on: what came before was start-up."""
        self._is_started = True

    def begin_anew(self) -> None:
        """What was measured so far was of another model."""
        self._samples.clear()
        self._counts_from = None

    def add(self, stamp: int, begun: int, published: int, dropped: int = 0) -> None:
        """Count a forecast of evidence of `stamp`, that was `begun` and `published` then (ns, one clock).

        `dropped`: sets that newer ones have replaced so far. Ignored where latency is assumed, because lockstep knows
        no time.
        """
        if not self.is_measured or not self._is_started:
            return
        if self._samples and published < self._samples[-1].published:
            self.begin_anew()  # the clock was set back: nothing would be old enough to be forgotten
        self._counts_from = published if self._counts_from is None else self._counts_from
        before = self._samples[-1] if self._samples else None
        gap = 0 if before is None else published - before.published
        is_slow = before is not None and gap + before.latency > SLOWS_NS
        is_ours = gap > HELD_UP_NS and dropped != self._dropped  # else it was the cameras that sent none meanwhile
        self._dropped = dropped
        self._samples.append(_Sample(published, published - stamp, published - begun, is_slow and is_ours))
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
    def slowed(self) -> int:
        """How often of late an arm had to slow down because the next set took this twin too long; 0 at first."""
        if self._counts_from is None or self._samples[-1].published - self._counts_from < SETTLED_NS:
            return 0
        return sum(sample.is_slow for sample in self._samples)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know: where half of all forecasts come too late an arm never moves, where some do it is
        slow."""
        if len(self._samples) < FEWEST:
            return ()
        if self.percentile_ms(50) <= LONGEST_BRIDGED_NS / 1e6:
            return self._slowed_warnings()
        return (
            f"latency: forecasts come {self.percentile_ms(50):.0f} ms after their images' stamps, and an arm stands "
            f"for what is older than {LONGEST_BRIDGED_NS / 1e6:.0f} ms; set the cameras' clocks if they are behind, "
            "else choose a smaller size or image width, or a faster machine",
        )

    def _slowed_warnings(self) -> tuple[str, ...]:
        slowed = self.slowed
        if slowed < OFTEN:
            return ()
        return (
            f"latency: {slowed} times in {MEMORY_NS * 1e-9:g} s the next forecast took so long that an arm slowed down "
            f"({SLOWS_NS / 1e6:.0f} ms after the images' stamps); choose a smaller size or image width, or free the "
            "processor",
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
    is_slow: bool
    """Whether an arm had slowed down by then, for the one before had become too old while a set waited."""
