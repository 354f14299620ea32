"""What a log consists of, whatever it is stored in."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

from rosbags.interfaces import Qos

from twin_node.errors import TwinError
from twin_node.messages import Message, MessageTypes


class BagError(TwinError):
    """A log, or what was to be written into one, is not what it should be."""


class DamageError(Exception):
    """A part of a log cannot be read on; the message is one line. It never leaves `LogReader`."""


@dataclass(frozen=True)
class Topic:
    """A topic of a log."""

    name: str
    msgtype: str
    """Full ROS 2 name, like sensor_msgs/msg/Image."""
    count: int
    """Number of messages."""
    latched: bool = False
    """True where a publisher offered it transient-local: a late joiner is given the last message."""


@dataclass(frozen=True)
class LogMessage:
    """One message of a log."""

    topic: str
    msgtype: str
    stamp: int
    """Log time, ns."""
    data: bytes | memoryview
    """CDR with encapsulation header."""
    types: MessageTypes = field(repr=False, compare=False)
    """The types as the log defines them for this topic."""
    published: int
    """When its publisher sent it, by its own clock, ns; the log time where the log does not say."""

    @cached_property
    def message(self) -> Message:
        """The message, deserialised at first use. Raises `MessageError` for an unknown type or damaged data."""
        return self.types.deserialize(self.data, self.msgtype)


@dataclass(frozen=True)
class Channel:
    """A topic as one file stores it."""

    topic: str
    msgtype: str
    encoding: str
    """How messages are serialised; only `cdr` is read."""
    count: int
    profiles: tuple[Qos, ...]
    """Quality of service that its publishers offered; none where the file does not say."""
    definition: str = ""
    """Text that defines its type; empty where the file has none."""


@dataclass(frozen=True)
class Record:
    """One stored message."""

    topic: str
    msgtype: str
    stamp: int
    """Log time, ns."""
    data: bytes
    published: int
    """Time of publishing, ns; the log time where the file has none."""
    definition: str = ""
    """That of its channel."""


@dataclass(frozen=True)
class Part:
    """A piece of a log that is read at one go: a chunk of an MCAP file, or a whole SQLite file."""

    storage: Storage
    start: int
    """Earliest and latest log time of its messages, ns."""
    end: int
    offset: int = 0
    """Where it stands in its file, bytes."""
    size: int = 0
    """Length in bytes."""
    topics: frozenset[str] | None = None
    """Topics that it has messages of; None where only reading it tells."""

    def holds(self, topics: Collection[str] | None, start: int, stop: int) -> bool:
        """Whether it may have messages of the topics (None: any) from `start` up to before `stop`, ns."""
        wanted = topics is None or self.topics is None or any(topic in self.topics for topic in topics)
        return wanted and self.start < stop and self.end >= start


class Storage(Protocol):
    """A file of a log, opened."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What the file holds."""

    @property
    def definitions(self) -> Mapping[str, str]:
        """Message definitions that the file carries: type name to text."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name."""

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of the files that it holds beside the messages, which nobody here reads."""

    @property
    def parts(self) -> tuple[Part, ...]:
        """All messages of the file, in the order of the file."""

    @property
    def damage(self) -> str | None:
        """One line about where the file ends too early, as known from opening it; None: it does not."""

    def records(self, part: Part, topics: Collection[str] | None, start: int, stop: int) -> Iterator[Record]:
        """Messages of a part from `start` up to before `stop` (ns) and of the given topics (None: all).

        They come in log-time order; raises `DamageError` where they cannot be read on.
        """

    def close(self) -> None:
        """Releases the file."""
