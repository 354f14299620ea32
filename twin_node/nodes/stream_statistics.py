"""How regularly the messages of a topic come: rate, gaps, jitter and delay, from their times alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_node.errors import several

GAP_PERIODS = 2.5
"""A pause longer than so many usual periods is a gap: more than one message is missing."""
FEWEST = 8
"""Messages without which nothing is said of a rate."""
JITTER_SHARE = 0.25
"""Jitter above this share of the period is named: stamps are arrival times, or a machine is overloaded."""


@dataclass(frozen=True)
class StreamStatistics:
    """Times of one topic's messages."""

    count: int
    rate_hz: float
    """From the usual (median) period; infinite where most have one stamp, NaN where most run backwards, or with too few
    messages."""
    jitter_ms: float
    """Standard deviation of periods, gaps and steps back left out, ms; NaN with too few messages."""
    gaps: int
    longest_gap_ms: float
    """Longest period, ms; NaN where there are too few messages."""
    backwards: int
    """Messages stamped before the one before."""


def statistics_of(stamps: Sequence[int]) -> StreamStatistics:
    """Statistics of stamps in ns, in the order in which the messages came."""
    periods = np.diff(np.array(stamps, dtype=np.int64)).astype(np.float64) / 1e6
    backwards = int((periods < 0).sum())
    if len(stamps) < FEWEST:
        return StreamStatistics(len(stamps), float("nan"), float("nan"), 0, float("nan"), backwards)
    usual = float(np.median(periods))
    is_gap = periods > GAP_PERIODS * usual if usual > 0 else np.zeros(len(periods), bool)
    regular = periods[~is_gap & (periods >= 0)]
    jitter = float(regular.std()) if len(regular) else float("nan")
    rate = 1e3 / usual if usual > 0 else float("inf") if usual == 0 else float("nan")
    return StreamStatistics(len(stamps), rate, jitter, int(is_gap.sum()), float(periods.max()), backwards)


def faults_of(statistics: StreamStatistics) -> tuple[str, ...]:
    """What a reader must know of a stream that should be regular."""
    found = []
    if statistics.backwards:
        found.append(f"{several(statistics.backwards, 'stamp')} run{'s' * (statistics.backwards == 1)} backwards")
    if statistics.gaps:
        found.append(f"{several(statistics.gaps, 'gap')}, the longest {statistics.longest_gap_ms:.0f} ms")
    if math.isinf(statistics.rate_hz):
        found.append("most stamps are the same as the one before: the clock that makes them stands")
    elif statistics.jitter_ms > JITTER_SHARE * 1e3 / statistics.rate_hz:
        found.append(f"jitter of {statistics.jitter_ms:.1f} ms at {statistics.rate_hz:.1f} Hz")
    return tuple(found)
