"""One MCAP file of the `ros2` profile as it is written: topics as they are announced, then their messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.writer import CompressionType, Writer

from twin_node.bag.folder_metadata import FolderFile, FolderTopic

IDL_BEGIN = "=" * 80 + "\nIDL: "
"""Of a definition in ROS 2's IDL: one section for each type, under a line that names it."""
PROFILE = "ros2"


@dataclass(frozen=True)
class Announced:
    """A topic, as it is announced."""

    name: str
    msgtype: str
    definition: str
    type_hash: str
    qos: str
    """`offered_qos_profiles`."""

    def in_folder(self, messages: int) -> FolderTopic:
        """As a folder's metadata tell of it and its messages in all files."""
        return FolderTopic(self.name, self.msgtype, self.qos, self.type_hash, messages)


@dataclass
class Written:
    """What has been written into a file."""

    counts: dict[str, int] = field(default_factory=dict)
    """Topic -> messages."""
    start: int | None = None
    """Log times of the first and the last message, ns."""
    end: int = 0

    def in_folder(self, name: str) -> FolderFile:
        """As a folder's metadata tell of the file."""
        return FolderFile(name, self.start, self.end, sum(self.counts.values()))


class McapStream:
    """Writes messages into an open file, whose header is written at once."""

    def __init__(self, file: BinaryIO, library: str, chunk_bytes: int, compression: CompressionType) -> None:
        """`chunk_bytes`: uncompressed size at which a chunk is closed."""
        self._writer = Writer(file, chunk_size=chunk_bytes, compression=compression)
        self._writer.start(PROFILE, library)
        self._schemas: dict[tuple[str, str], int] = {}
        """By type and definition."""
        self._channels: dict[str, int] = {}
        self.topics: dict[str, Announced] = {}
        self.written = Written()

    def add_topic(self, topic: Announced) -> None:
        """Announces a topic before its first message."""
        self.topics[topic.name] = topic
        key = topic.msgtype, topic.definition
        if key not in self._schemas:
            form = "ros2idl" if topic.definition.startswith(IDL_BEGIN) else "ros2msg"
            self._schemas[key] = self._writer.register_schema(topic.msgtype, form, topic.definition.encode())
        qos = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.type_hash}
        self._channels[topic.name] = self._writer.register_channel(topic.name, "cdr", self._schemas[key], qos)
        self.written.counts.setdefault(topic.name, 0)

    def write(self, topic: str, data: bytes | memoryview, stamp_ns: int, published_ns: int) -> None:
        """Writes CDR bytes at a log time, ns."""
        written, stamp = self.written, int(stamp_ns)  # YAML knows no integers of NumPy's
        self._writer.add_message(self._channels[topic], stamp, data, published_ns, written.counts[topic])
        written.counts[topic] += 1
        written.start = stamp if written.start is None else min(written.start, stamp)
        written.end = max(written.end, stamp)

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Adds a record of strings."""
        self._writer.add_metadata(name, dict(record))

    def flush(self) -> None:
        """Closes the chunk in progress."""
        self._writer.flush()

    def finish(self) -> None:
        """Writes what stands behind all messages; the file is left open."""
        self._writer.finish()
