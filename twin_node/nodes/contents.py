"""What the messages of a log hold, and where one stands that is damaged."""

from __future__ import annotations

from twin_node.bag import LogMessage, LogReader
from twin_node.messages import Message, MessageError
from twin_node.nodes.topics import GraphError


def content_of(message: LogMessage, log: LogReader) -> Message:
    """A message of `log`. Raises `GraphError` naming log, topic and time of one that is damaged."""
    try:
        return message.message
    except MessageError as error:
        after_s = (message.stamp - log.start_ns) / 1e9
        raise GraphError(
            f"{log.path}: {message.topic}, {after_s:.3f} s after the log's start: {error}; see what else is with "
            f"'twin_node check {log.path}', or leave the time out with --start-offset or --duration"
        ) from None
