"""What is said of the times of a stream: each fault by its own name, and by no other."""

from __future__ import annotations

import math

from twin_node.nodes.stream_statistics import faults_of, statistics_of

MS = 1_000_000
START = 1_700_000_000_000 * MS
PERIOD = 33 * MS


def regular(count: int, start: int = START) -> list[int]:
    return [start + k * PERIOD for k in range(count)]


def test_a_clock_that_was_set_back_once_is_no_jitter() -> None:
    """As one that was set ahead is a gap: the stream is as regular before and behind as any."""
    found = statistics_of([*regular(50), *regular(50, START - 3_000 * MS)])
    assert (found.backwards, found.gaps, found.jitter_ms) == (1, 0, 0.0)
    assert faults_of(found) == ("1 stamp runs backwards",)


def test_stamps_that_go_to_and_fro_do_not_stand() -> None:
    """Two devices on one topic, by two clocks: every other message is stamped before the one that came before it."""
    ours, theirs = regular(20), regular(20, START - 100 * MS)
    for stamps in ([stamp for pair in zip(ours, theirs, strict=True) for stamp in pair], list(reversed(ours))):
        found = statistics_of(stamps)
        assert math.isnan(found.rate_hz)
        assert faults_of(found) == (f"{found.backwards} stamps run backwards",)


def test_a_clock_that_stands_is_said_to() -> None:
    (fault,) = faults_of(statistics_of([START] * 20))
    assert fault == "most stamps are the same as the one before: the clock that makes them stands"
