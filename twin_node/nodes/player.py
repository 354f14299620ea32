"""Plays a log onto a bus: message by message, or at the pace it was recorded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from twin_node.bag import LogReader
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import PacedClock, SteppedClock

Progress = Callable[[int], None]
"""Called with the log time, ns, of every message played."""


@dataclass(frozen=True)
class Span:
    """The part of a log to play."""

    start_ns: int
    stop_ns: int
    """Exclusive."""

    @property
    def seconds(self) -> float:
        """Length, s."""
        return (self.stop_ns - self.start_ns) / 1e9


def span_of(log: LogReader, start_offset_s: float = 0.0, duration_s: float | None = None) -> Span:
    """The part of `log` that begins `start_offset_s` after its start and lasts `duration_s` (None: to the end)."""
    start = log.start_ns + int(start_offset_s * 1e9)
    stop = log.end_ns + 1
    return Span(start, stop if duration_s is None else min(stop, start + int(duration_s * 1e9)))


class Player:
    """Reads the wanted topics of a log and publishes their messages under their remapped names."""

    def __init__(self, log: LogReader, bus: Bus, topics: dict[str, str], span: Span) -> None:
        """`topics` maps the log's topic names to the names they are published under."""
        self._log = log
        self._bus = bus
        self._topics = topics
        self._span = span

    def play(self, clock: SteppedClock | PacedClock, on_progress: Progress, stop: Callable[[], bool]) -> None:
        """Publish every message of the span, in the log's order; a `PacedClock` is waited for, a stepped one is moved."""
        span = self._span
        for message in self._log.messages(self._topics, span.start_ns, span.stop_ns):
            if stop():
                return
            if isinstance(clock, SteppedClock):
                clock.advance_to(message.stamp)
            else:
                wait = clock.seconds_until(message.stamp)
                if wait > 0:
                    time.sleep(wait)
            self._bus.publish(self._topics[message.topic], message.message)
            on_progress(message.stamp)
