"""What the messages of a log hold, and where one stands that is damaged."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TypeVar

from twin_node.bag import LogMessage, LogReader
from twin_node.errors import TwinError
from twin_node.messages import Message, MessageError
from twin_node.nodes.topics import GraphError

Record = TypeVar("Record")


def content_of(message: LogMessage, log: LogReader) -> Message:
    """A message of `log`. Raises `GraphError` naming log, topic and time of one that is damaged."""
    return record_of(message, log, lambda content: content, ", or leave the time out with --start-offset or --duration")


def record_of(message: LogMessage, log: LogReader, convert: Callable[[Message], Record], advice: str = "") -> Record:
    """What `convert` makes of a message of `log`.

    Raises `GraphError` naming log, topic and time where it cannot; `advice`: what helps beside a look at the log.
    """
    try:
        return convert(message.message)
    except MessageError as error:
        place = _place(log, message.topic, message.stamp)
        raise GraphError(f"{place}: {error}; see what else is with 'twin_node check {log.path}'{advice}") from None


@contextlib.contextmanager
def told_of(log: LogReader, topic: str, stamp: int | None = None) -> Iterator[None]:
    """While somebody works on a message of `log`; `stamp`: when it was recorded, ns, where that is known.

    Raises `GraphError` naming log, topic and time for any `TwinError`.
    """
    try:
        yield
    except TwinError as error:
        raise GraphError(f"{_place(log, topic, stamp)}: {error}") from error


def _place(log: LogReader, topic: str, stamp: int | None) -> str:
    after = "" if stamp is None else f", {(stamp - log.start_ns) / 1e9:.3f} s after the log's start"
    return f"{log.path}: {topic}{after}"
