"""The bus of nodes that share a thread but not a process, or not a machine, with those that they talk to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from twin_node.errors import TwinError
from twin_node.messages import Message
from twin_node.messages.services import ServiceType
from twin_node.runtime.executor import Executor, Inbox
from twin_node.runtime.names import within, without
from twin_node.runtime.qos import KindOf, TopicKind
from twin_node.runtime.services import PATIENCE_S, Answer, Reply
from twin_node.runtime.wire import Cancel, Encoded, Send, Sink, Wire, encoded

T = TypeVar("T")

REQUESTS_KEPT = 16
"""Requests of a service that wait for the node; of more the oldest get no answer."""


@dataclass(frozen=True)
class Traffic:
    """What became of the messages of one subscription."""

    topic: str
    received: int
    dropped: int
    """Replaced by newer ones before the node had time for them, or too old by then."""
    unreadable: int
    """Bytes that are not a message of the topic's type, or a message that the node refused."""
    last_error: str | None


class BusError(TwinError):
    """A topic is to be used of which nobody has said what it carries."""


class _Timed:
    """A message on its way to its callback, and when it came."""

    __slots__ = ("came", "message")

    def __init__(self, message: Any, came: Any) -> None:
        self.message, self.came = message, came

    @property
    def data(self) -> Any:
        """By its size the inbox counts it."""
        return getattr(self.message, "data", None)


class _Subscription:
    """One callback's messages, decoded in its own thread."""

    def __init__(self, topic: str, callback: Callable[[Any], None], raw: bool) -> None:
        self.topic = topic
        self._callback = callback
        self._raw = raw
        self.received = 0
        self.unreadable = 0
        self.last_error: str | None = None
        self.is_closed = False

    def __call__(self, message: Any) -> None:
        self.received += 1
        if self.is_closed:
            return
        try:
            if self._raw:
                self._callback(encoded(message))
            else:
                self._callback(message.decode() if isinstance(message, Encoded) else message)
        except TwinError as error:
            # One message of many: the rest is worth having; diagnostics tell of it once a second.
            self.unreadable += 1
            self.last_error = str(error)


class WireBus:
    """The bus of the nodes of one thread: what they publish goes onto a wire, what they are sent waits in inboxes.

    A callback may raise a `TwinError` for a message that it cannot use; that is counted, kept for the diagnostics, and
    the next message is taken. Anything else that it raises ends the executor.
    """

    def __init__(
        self, wire: Wire, executor: Executor, node: str, kind_of: KindOf, remaps: Mapping[str, str] | None = None
    ) -> None:
        """`node`: the name that others see; `kind_of`: what topics carry, where `declare` has not said otherwise.

        `remaps`: the nodes' own names of topics -> those that they have on the wire; others have the wire's namespace
        before them.
        """
        self._wire = wire
        self._executor = executor
        self._node = node
        self._kind_of = kind_of
        self._remaps = remaps or {}
        self._declared: dict[str, TopicKind] = {}
        self._senders: dict[str, Send] = {}
        self._subscriptions: list[tuple[_Subscription, Inbox]] = []
        self._cancels: list[Cancel] = []

    def declare(self, topic: str, kind: TopicKind) -> None:
        """Says what a topic carries, before it is first used: whatever the graph itself does not have.

        What is published is known by the message, with the QoS of rclcpp's default profile.
        """
        self._declared[topic] = kind

    def resolved(self, topic: str) -> str:
        """The name that a node's topic has on the wire."""
        return self._remaps.get(topic) or within(self._wire.namespace, topic)

    def renamed(self, topic: str) -> str:
        """The name that it has within the namespace, and in recordings: its own, or that which it was given."""
        return self._remaps.get(topic, topic)

    def named(self, topic: str) -> str | None:
        """The node's own name of a topic on the wire.

        None: it has none, as a topic of another namespace, or one whose name the node has for another.
        """
        own = next((own for own, name in self._remaps.items() if name == topic), None)
        own = own or without(self._wire.namespace, topic)
        return own if own is not None and self.resolved(own) == topic else None

    def publish(self, topic: str, message: Any) -> None:
        """Send `message`, which may be `Encoded`, to everyone who subscribes to `topic`."""
        send = self._senders.get(topic)
        if send is None:
            msgtype = message.msgtype if isinstance(message, Encoded) else getattr(message, "__msgtype__", None)
            kind = replace(self._known(topic) or TopicKind(msgtype), msgtype=msgtype)
            send = self._senders[topic] = self._wire.publisher(self._node, self.resolved(topic), kind)
        send(message)

    def advertise(self, topic: str) -> None:
        """Lets others know of a topic before anything is published on it: who finds it only then misses the first.

        Raises `BusError` where nobody knows what it carries.
        """
        self._wire.advertise(self._node, self.resolved(topic), self._kind(topic))

    def is_heard(self, topic: str) -> bool:
        """Whether anybody would get what is published on `topic`: what is costly is not made for nobody.

        Raises `BusError` where nobody knows what it carries.
        """
        return self._wire.is_heard(self._node, self.resolved(topic), self._kind(topic))

    def subscribe(self, topic: str, callback: Callable[[Any], None]) -> None:
        """Call `callback(message)` in the executor's thread for every message on `topic`.

        Raises `BusError` where nobody knows what it carries: by its type and its QoS others find it.
        """
        self._subscribe(topic, callback, raw=False)

    def subscribe_raw(self, topic: str, callback: Callable[[Encoded], None]) -> Cancel:
        """Call `callback(encoded)` for every message on `topic`, undecoded, until cancelled in that thread."""
        return self._subscribe(topic, callback, raw=True)

    def subscribe_timed(self, topic: str, callback: Callable[[Encoded, T], None], now: Callable[[], T]) -> None:
        """Call `callback(encoded, came)` for every message on `topic`, undecoded.

        `came`: what `now()` said when it came, which is called in any thread; it may have waited for its callback
        since.
        """

        def call(timed: _Timed) -> None:
            callback(encoded(timed.message), timed.came)

        def timed(offer: Sink) -> Sink:
            return lambda message: offer(_Timed(message, now()))

        self._subscribe(topic, call, raw=False, to=timed)

    def serve(self, name: str, service: ServiceType, answer: Answer) -> None:
        """Call `answer(request, reply)` in the executor's thread for every request of the service `name`.

        One that the node comes to when its client has given up is passed over: what it asks for may be wrong by then.
        """

        inbox = self._executor.inbox(lambda asked: answer(*asked), REQUESTS_KEPT, lifespan_s=PATIENCE_S)

        def put_aside(request: Message, reply: Reply) -> None:
            inbox.offer((request, reply))

        self._cancels.append(self._wire.serve(self._node, name, service, put_aside))

    def dropped(self, topic: str) -> int:
        """Messages on `topic` that newer ones replaced, or that got too old, before a callback had time for them."""
        return sum(inbox.dropped for subscription, inbox in self._subscriptions if subscription.topic == topic)

    def is_waiting(self, topic: str) -> bool:
        """Whether a message on `topic` waits for a callback of this bus."""
        return any(inbox.is_waiting for subscription, inbox in self._subscriptions if subscription.topic == topic)

    @property
    def traffic(self) -> tuple[Traffic, ...]:
        """What became of the messages of every subscription."""
        return tuple(
            Traffic(s.topic, s.received + inbox.dropped, inbox.dropped, s.unreadable, s.last_error)
            for s, inbox in self._subscriptions
        )

    def close(self) -> None:
        """Ends all subscriptions and services; what waits in inboxes will be forgotten. Again it does nothing."""
        while self._cancels:
            self._cancels.pop()()
        for subscription, _ in self._subscriptions:
            subscription.is_closed = True

    def _subscribe(
        self, topic: str, callback: Callable[[Any], None], raw: bool, to: Callable[[Sink], Sink] = lambda offer: offer
    ) -> Cancel:
        """`to(offer)`: what takes messages from the wire and offers them to the inbox, in any thread."""
        kind = self._kind(topic)
        subscription = _Subscription(topic, callback, raw)
        qos = kind.qos
        inbox = self._executor.inbox(subscription, qos.depth, qos.patience, qos.most_bytes, qos.lifespan_s)
        self._subscriptions.append((subscription, inbox))
        end = self._wire.subscribe(self._node, self.resolved(topic), kind, to(inbox.offer))
        self._cancels.append(end)

        def cancel() -> None:
            subscription.is_closed = True
            if end in self._cancels:
                self._cancels.remove(end)
                end()

        return cancel

    def _kind(self, topic: str) -> TopicKind:
        kind = self._known(topic)
        if kind is None:
            raise BusError(
                f"node '{self._node}': expected to know what {topic} carries, found no such topic of the graph's own; "
                f"say so before, for example declare('{topic}', TopicKind('std_msgs/msg/String'))"
            )
        return kind

    def _known(self, topic: str) -> TopicKind | None:
        return self._declared.get(topic) or self._kind_of(topic)
