"""Records topics into a log."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from twin_node.bag import LogWriter
from twin_node.messages import header_stamp
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import Clock
from twin_node.runtime.node import Node


class RecorderNode(Node):
    """Writes every message of the given topics, at the time it is published."""

    def __init__(self, bus: LocalBus, clock: Clock, log: LogWriter, topics: Collection[str]) -> None:
        super().__init__("recorder", bus, clock)
        self._local_bus = bus
        self._log = log
        self._topics = frozenset(topics)

    def on_configure(self) -> None:
        self._local_bus.tap(self._on_message)

    def _on_message(self, topic: str, message: Any) -> None:
        if topic in self._topics:
            self._log.write(topic, message, max(self.clock.now(), header_stamp(message)))
