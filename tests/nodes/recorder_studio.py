"""A recorder of a live graph, among messages of a test's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from twin_node.messages import convert
from twin_node.nodes.live.recorder import LiveRecorderNode, RecordParameters
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import DIAGNOSTICS, TF_STATIC, kind_of
from twin_node.runtime.clock import Clock
from twin_node.runtime.executor import Executor
from twin_node.runtime.qos import TopicKind
from twin_node.runtime.rmw_zenoh import Endpoint
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus


class Studio:
    """A recorder, and a wire to speak on."""

    def __init__(
        self,
        output: Path,
        clock: Clock,
        is_active: bool = True,
        say: Callable[[str], None] | None = None,
        remaps: Mapping[str, str] | None = None,
        namespace: str = "/",
        **more: Any,
    ) -> None:
        self.said: list[str] = []
        self.graph: tuple[Endpoint, ...] = ()
        self.is_finished = False
        self._wire, self._executor = LocalWire(), Executor()
        self._wire.namespace = namespace
        bus = WireBus(self._wire, self._executor, "recorder", kind_of, remaps)
        say = say or self.said.append
        setup = Setup("recorder", bus, clock, self._executor, {}, "test", self._finish, lambda: self.graph, say)
        topics = {"topics": (DIAGNOSTICS, TF_STATIC), **more}
        self.node = LiveRecorderNode(setup, RecordParameters(str(output), **topics))
        self.node.configure()
        if is_active:
            self.node.activate()

    def _finish(self) -> None:
        self.is_finished = True

    def hear(self, topic: str, message: Any) -> None:
        self.bring(topic, message)
        self.run()

    def bring(self, topic: str, message: Any) -> None:
        """What comes while the recorder waits for its disk."""
        self._wire.publisher("somebody", topic, kind_of(topic) or TopicKind(message.__msgtype__))(message)

    def hear_at_once(self, *messages: Any) -> None:
        """Diagnostics that come while the recorder waits for its disk."""
        for message in messages:
            self.bring(DIAGNOSTICS, message)

    def run(self) -> None:
        while self._executor.step(0.0):
            pass

    def step(self) -> None:
        self._executor.step(60.0)

    def hear_diagnostics(self) -> None:
        self.hear(DIAGNOSTICS, convert.diagnostics_to_message(0, []))

    def end(self) -> None:
        self.node.deactivate()
        self.node.cleanup()
