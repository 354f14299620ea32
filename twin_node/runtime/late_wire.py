"""A wire that is there before it is open: nodes are made with it, and take part in the graph later."""

from __future__ import annotations

from twin_node.messages.services import ServiceType
from twin_node.runtime.qos import TopicKind
from twin_node.runtime.rmw_zenoh import Endpoint
from twin_node.runtime.services import Answer
from twin_node.runtime.wire import Cancel, Send, Sink
from twin_node.runtime.zenoh_session import WireError, ZenohParameters
from twin_node.runtime.zenoh_wire import ZenohWire


class LateWire:
    """This process's end of the network from `open` on; before that nobody sees it, and it costs nothing."""

    def __init__(self, parameters: ZenohParameters) -> None:
        self._parameters = parameters
        self._opened: ZenohWire | None = None

    @property
    def namespace(self) -> str:
        """As `ZenohWire.namespace`."""
        return self._parameters.namespace

    def open(self) -> None:
        """Joins the network. Raises `WireError` where zenoh is not installed, or its configuration is refused."""
        self._opened = ZenohWire(self._parameters)

    def publisher(self, node: str, topic: str, kind: TopicKind) -> Send:
        """As `ZenohWire.publisher`. Raises `WireError` while the wire is not open."""
        return self._wire.publisher(node, topic, kind)

    def subscribe(self, node: str, topic: str, kind: TopicKind, sink: Sink) -> Cancel:
        """As `ZenohWire.subscribe`. Raises `WireError` while the wire is not open."""
        return self._wire.subscribe(node, topic, kind, sink)

    def advertise(self, node: str, topic: str, kind: TopicKind) -> None:
        """As `ZenohWire.advertise`. Raises `WireError` while the wire is not open."""
        self._wire.advertise(node, topic, kind)

    def is_heard(self, node: str, topic: str, kind: TopicKind) -> bool:
        """As `ZenohWire.is_heard`. Raises `WireError` while the wire is not open."""
        return self._wire.is_heard(node, topic, kind)

    def serve(self, node: str, name: str, service: ServiceType, answer: Answer) -> Cancel:
        """As `ZenohWire.serve`. Raises `WireError` while the wire is not open."""
        return self._wire.serve(node, name, service, answer)

    def endpoints(self) -> tuple[Endpoint, ...]:
        """As `ZenohWire.endpoints`; none while the wire is not open."""
        return () if self._opened is None else self._opened.endpoints()

    def close(self) -> None:
        """Ends all traffic."""
        if self._opened is not None:
            self._opened.close()

    @property
    def _wire(self) -> ZenohWire:
        if self._opened is None:
            raise WireError("a node spoke or listened before it was configured; it may do so from `on_configure` on")
        return self._opened
