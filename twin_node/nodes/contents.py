"""What the messages of a log hold, and where one stands that is damaged."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from twin_node.bag import LogMessage, LogReader
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
        after_s = (message.stamp - log.start_ns) / 1e9
        raise GraphError(
            f"{log.path}: {message.topic}, {after_s:.3f} s after the log's start: {error}; see what else is with "
            f"'twin_node check {log.path}'{advice}"
        ) from None
