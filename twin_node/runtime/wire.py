"""What carries messages between the threads and processes of a graph, and the carrier within one process."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from twin_node.messages import Message, MessageTypes, builtin_types, serialize
from twin_node.messages.services import ServiceType
from twin_node.runtime.names import ROOT
from twin_node.runtime.qos import TopicKind
from twin_node.runtime.rmw_zenoh import Endpoint
from twin_node.runtime.services import Answer


@dataclass(frozen=True)
class Encoded:
    """A message as bytes: decoded by whom it reaches, or passed on as it is."""

    msgtype: str
    """Full ROS 2 name."""
    data: bytes | memoryview
    """CDR with encapsulation header."""
    types: MessageTypes = field(repr=False, compare=False, default_factory=builtin_types)
    """Where the type is defined."""

    def decode(self) -> Message:
        """The message. Raises `MessageError` for an unknown type or damaged data."""
        return self.types.deserialize(self.data, self.msgtype)


def encoded(message: Any) -> Encoded:
    """A message of the built-in set as bytes; one that is encoded is returned as it is."""
    if isinstance(message, Encoded):
        return message
    return Encoded(message.__msgtype__, bytes(serialize(message)))


Sink = Callable[[Any], None]
"""Takes a message or an `Encoded` one; called in any thread, so it must only put it aside."""
Send = Callable[[Any], None]
"""Sends a message, an `Encoded` one, or, inside a process, a record."""
Cancel = Callable[[], None]
"""Ends a subscription."""


class Wire(Protocol):
    """Topics that reach beyond one thread."""

    @property
    def namespace(self) -> str:
        """Of all its nodes."""

    def publisher(self, node: str, topic: str, kind: TopicKind) -> Send:
        """A function that sends messages of node `node` on `topic`; in any thread."""

    def subscribe(self, node: str, topic: str, kind: TopicKind, sink: Sink) -> Cancel:
        """Hands every message on `topic` to `sink` until cancelled; what is kept of a latched topic comes at once."""

    def advertise(self, node: str, topic: str, kind: TopicKind) -> None:
        """Tells the graph that node `node` will send on `topic`, before it does."""

    def is_heard(self, node: str, topic: str, kind: TopicKind) -> bool:
        """Whether anybody would get what node `node` sends on `topic`."""

    def serve(self, node: str, name: str, service: ServiceType, answer: Answer) -> Cancel:
        """Answers as node `node` what other processes ask of the service `name`, until cancelled.

        `name`: without the namespace.
        """

    def endpoints(self) -> tuple[Endpoint, ...]:
        """What nodes of the whole graph send, hear and serve, as far as this end has been told by now."""

    def close(self) -> None:
        """Ends all traffic."""


class LocalWire:
    """Carries messages between the threads of this process, by reference: they must not be changed."""

    namespace = ROOT

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sinks: dict[str, list[Sink]] = {}
        self._latched: dict[str, dict[tuple[str, str], deque[Any]]] = {}

    def publisher(self, node: str, topic: str, kind: TopicKind) -> Send:
        """A function that hands messages to every sink of `topic`."""
        identity = (node, topic)

        def send(message: Any) -> None:
            with self._lock:
                if kind.qos.latched:
                    kept = self._latched.setdefault(topic, {}).setdefault(identity, deque(maxlen=kind.qos.depth))
                    kept.append(message)
                sinks = tuple(self._sinks.get(topic, ()))
            for sink in sinks:
                sink(message)

        return send

    def subscribe(self, node: str, topic: str, kind: TopicKind, sink: Sink) -> Cancel:
        """Hands every message on `topic` to `sink`; what every publisher keeps of a latched topic comes at once."""
        with self._lock:  # what is sent meanwhile comes after what is kept, which it may replace
            self._sinks.setdefault(topic, []).append(sink)
            if kind.qos.latched:
                for kept in self._latched.get(topic, {}).values():
                    for message in kept:
                        sink(message)

        def cancel() -> None:
            with self._lock:
                if sink in self._sinks.get(topic, ()):  # a wire that is closed has none
                    self._sinks[topic].remove(sink)

        return cancel

    def advertise(self, node: str, topic: str, kind: TopicKind) -> None:
        """Nothing: threads of one process need no discovery."""

    def is_heard(self, node: str, topic: str, kind: TopicKind) -> bool:
        """Whether a thread of this process listens."""
        with self._lock:
            return bool(self._sinks.get(topic))

    def serve(self, node: str, name: str, service: ServiceType, answer: Answer) -> Cancel:
        """Nothing: threads of one process ask each other nothing."""
        return lambda: None

    def endpoints(self) -> tuple[Endpoint, ...]:
        """None: threads of one process need no discovery."""
        return ()

    def close(self) -> None:
        """Forgets all sinks."""
        with self._lock:
            self._sinks.clear()
