"""Log times as rosbag2 has them, int64 ns from 0: MCAP's reach twice as far, those of SQLite begin below."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path

from twin_node.bag.log import BagError, DamageError, Part
from twin_node.errors import several

NO_START, NO_STOP = 0, 2**63
"""Bounds in ns that every log time lies within, from the first on and before the second."""
RANGE = "0 to 2^63 - 1 ns"
"""The same, for messages to people."""


def check_log_time(stamp: int, topic: str, path: Path) -> None:
    """Raises `BagError` for a log time that no log can have; `path`: of the log."""
    if not isinstance(stamp, Integral):
        raise BagError(
            f"{path}: message on {topic} at {stamp!r} ns; expected whole nanoseconds: of seconds give "
            "round(1e9 * seconds)"
        )
    if not NO_START <= stamp < NO_STOP:
        raise BagError(f"{path}: message on {topic} at {stamp} ns; expected a log time from {RANGE}")


def check_published(stamp: int, topic: str, path: Path) -> None:
    """Raises `BagError` for a time of publishing that no log can hold; `path`: of the log."""
    if not isinstance(stamp, Integral) or not 0 <= stamp < 2 * NO_STOP:
        raise BagError(
            f"{path}: message on {topic} published at {stamp!r} ns; expected whole nanoseconds from 0 to 2^64 - 1"
        )


@dataclass(frozen=True)
class Within:
    """What of a log has log times that can be."""

    parts: tuple[Part, ...]
    """Parts with such messages, their times those of such messages."""
    outside: Mapping[tuple[str, str], int]
    """Topic and type -> number of messages at other times."""

    @property
    def lines(self) -> tuple[str, ...]:
        """What is outside, a line per topic and type."""
        return tuple(
            f"{topic}: {several(count, 'message')} of {msgtype} at log times that cannot be; expected {RANGE}"
            for (topic, msgtype), count in self.outside.items()
        )


def within(parts: Iterable[Part]) -> Within:
    """Looks for messages at times that cannot be; only parts that have such times are read."""
    kept: list[Part] = []
    outside: Counter[tuple[str, str]] = Counter()
    for part in parts:
        if part.start >= NO_START and part.end < NO_STOP:
            kept.append(part)
        else:
            kept += _narrowed(part, outside)
    return Within(tuple(kept), outside)


def _narrowed(part: Part, outside: Counter[tuple[str, str]]) -> list[Part]:
    """The part with the times of messages within, if it has any; counts the others."""
    stamps: list[int] = []
    try:
        for record in part.storage.records(part, None, min(part.start, NO_START), max(part.end + 1, NO_STOP)):
            if NO_START <= record.stamp < NO_STOP:
                stamps.append(record.stamp)
            else:
                outside[record.topic, record.msgtype] += 1
    except DamageError:  # whoever reads the part meets it again, and tells
        stamps += [min(max(time, NO_START), NO_STOP - 1) for time in (part.start, part.end)]
    return [replace(part, start=min(stamps), end=max(stamps))] if stamps else []
