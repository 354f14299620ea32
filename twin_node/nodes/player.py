"""Plays a log onto a bus: message by message, or at the pace it was recorded."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from twin_node.bag import LogReader
from twin_node.nodes.contents import content_of, told_of
from twin_node.nodes.topics import OF_THE_ARM, GraphError
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import PacedClock, SteppedClock


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
    """The part of `log` that begins `start_offset_s` after its start and lasts `duration_s` (None: to the end).

    Raises `GraphError` when that is past the log's end.
    """
    stop = log.end_ns + 1
    if start_offset_s * 1e9 >= stop - log.start_ns:
        length = (log.end_ns - log.start_ns) / 1e9
        raise GraphError(f"{log.path}: --start-offset {start_offset_s:g} s is past its end; it lasts {length:.2f} s")
    start = log.start_ns + int(start_offset_s * 1e9)
    if duration_s is None or duration_s * 1e9 >= stop - start:
        return Span(start, stop)
    return Span(start, start + int(duration_s * 1e9))


class Player:
    """Reads the wanted topics of a log and publishes their messages under their new names."""

    def __init__(self, log: LogReader, bus: Bus, topics: Mapping[str, str], span: Span) -> None:
        """`topics` maps the log's topic names to the names they are published under."""
        self._log = log
        self._bus = bus
        self._topics = topics
        self._span = span

    def steps(self, clock: SteppedClock | PacedClock, patience_s: float = math.inf) -> Iterator[int]:
        """Publish the span's messages in the log's order; yields the log time, ns, after each.

        A stepped clock is moved to each message's time, a paced one is waited for: where that takes longer than
        `patience_s`, the time is yielded so often meanwhile. Raises `GraphError` for a message that is damaged, and for
        one about the arm that who hears it cannot use.
        """
        for message in self._log.messages(list(self._topics), self._span.start_ns, self._span.stop_ns):
            if isinstance(clock, SteppedClock):
                clock.advance_to(message.stamp)
            else:
                while (left_s := clock.seconds_until(message.stamp)) > patience_s:
                    time.sleep(patience_s)
                    yield clock.now()
                time.sleep(max(0.0, left_s))
            topic, content = self._topics[message.topic], content_of(message, self._log)
            is_of_arm = topic in OF_THE_ARM
            with told_of(self._log, message.topic, message.stamp) if is_of_arm else contextlib.nullcontext():
                self._bus.publish(topic, content)
            yield message.stamp
