"""Recordings that tests make, and what is read of them."""

from __future__ import annotations

from pathlib import Path

from twin_node.bag import RecordingWriter, open_log
from twin_node.messages import builtin_types, message_type, serialize

STRING = "std_msgs/msg/String"
STEP = 100_000_000


def text(data: str) -> bytes:
    return bytes(serialize(message_type(STRING)(data=data)))


def fill(writer: RecordingWriter, count: int, size: int = 100) -> None:
    types = builtin_types()
    writer.write("/tf_static", STRING, text("where things are"), 0, types)
    for i in range(1, count):
        writer.write("/a", STRING, text(str(i).zfill(size)), i * STEP, types)


def stamps_of(path: Path, topic: str = "/a") -> list[int]:
    with open_log(path) as log:
        return [message.stamp for message in log.messages([topic])]
