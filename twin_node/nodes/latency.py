"""How long evidence is under way: measured when live, assumed in lockstep."""

from __future__ import annotations

from collections import deque

import numpy as np

ASSUMED_LATENCY_NS = 33_000_000
"""From evidence to publication in lockstep, and before it was measured: one frame at 30 Hz."""
SAMPLES = 300
"""Latencies that the percentiles are taken over: 10 s at 30 Hz."""
FEWEST = 30
"""Latencies below which what is assumed stands."""
LONGEST_BRIDGED_NS = 400_000_000
"""No forecast begins later after its evidence: by then an arm stands (`arm.LimiterParameters`). One set that was held
up, or a clock that was set while it was under way, would have all that moves forecast to be minutes away."""


class Latency:
    """Percentiles of the last latencies from evidence stamp to publication."""

    def __init__(self, assumed_ns: int, is_measured: bool) -> None:
        """`assumed_ns` stands for the p99 until enough was measured, and for ever where `is_measured` is False."""
        self._assumed_ns = assumed_ns
        self.is_measured = is_measured
        self._is_started = False
        self._samples_ns: deque[int] = deque(maxlen=SAMPLES)

    def start(self) -> None:
        """Measure from now on: what came before was start-up."""
        self._is_started = True

    def add(self, latency_ns: int) -> None:
        """Count one latency; ignored where latency is assumed, because lockstep knows no time."""
        if self.is_measured and self._is_started:
            self._samples_ns.append(latency_ns)

    @property
    def expected_ns(self) -> int:
        """What a forecast must bridge to be valid when it is read: the p99, ns; 0 where cameras' clocks are ahead.

        At most `LONGEST_BRIDGED_NS`.
        """
        if len(self._samples_ns) < FEWEST:
            return self._assumed_ns
        return min(max(int(np.percentile(self._samples_ns, 99)), 0), LONGEST_BRIDGED_NS)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know: where half of all forecasts come too late, an arm never moves."""
        if len(self._samples_ns) < FEWEST or self.percentile_ms(50) <= LONGEST_BRIDGED_NS / 1e6:
            return ()
        return (
            f"latency: forecasts come {self.percentile_ms(50):.0f} ms after their images' stamps, and an arm stands "
            f"for what is older than {LONGEST_BRIDGED_NS / 1e6:.0f} ms; set the cameras' clocks if they are behind, "
            "else choose a smaller size or image width, or a faster machine",
        )

    def percentile_ms(self, percent: float) -> float:
        """A percentile of the measured latencies, ms; NaN without samples."""
        return float(np.percentile(self._samples_ns, percent)) / 1e6 if self._samples_ns else float("nan")
