"""Records topics into a log."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import Protocol

from twin_node.messages import Message, header_stamp
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.node import Node


class MessageLog(Protocol):
    """Takes messages: a `LogWriter`, or what goes on where its disk refuses."""

    def write(self, topic: str, message: Message, stamp_ns: int) -> None: ...


class RecorderNode(Node):
    """Writes every message of the given topics, at the time it is published."""

    def __init__(self, bus: Bus, clock: Clock, log: MessageLog, topics: Collection[str], is_live: bool = False) -> None:
        """`is_live`: messages are of when they come, whatever they are stamped with: it may be by another clock."""
        super().__init__("recorder", bus, clock)
        self._log = log
        self._topics = tuple(dict.fromkeys(topics))
        self._is_live = is_live

    def on_configure(self) -> None:
        for topic in self._topics:
            self.bus.subscribe(topic, partial(self._on_message, topic))

    def _on_message(self, topic: str, message: Message) -> None:
        now = self.clock.now()
        self._log.write(topic, message, now if self._is_live else max(now, header_stamp(message)))
