"""Carries messages between processes and machines over zenoh, such that ROS 2 nodes on rmw_zenoh take part.

Within a process messages go by reference; over zenoh go their CDR bytes, under the keys and with the tokens and
attachments of `rmw_zenoh`. A message that is older than one of its publisher's that has already come is refused.
"""

from __future__ import annotations

import atexit
import itertools
import threading
import time
from collections.abc import Callable
from functools import cache
from typing import Any

from twin_node.messages import builtin_types
from twin_node.messages.services import ServiceType
from twin_node.runtime.names import within
from twin_node.runtime.qos import RELIABLE, TopicKind
from twin_node.runtime.rmw_zenoh import (
    ADMIN_SPACE,
    HUMBLE_HASH,
    Attachment,
    Endpoint,
    EntityKind,
    NodeIdentity,
    endpoint_token,
    gid_of,
    node_token,
    parse_token,
    topic_key,
    unpack_attachment,
)
from twin_node.runtime.services import Answer, ServiceDesk
from twin_node.runtime.wire import Cancel, Encoded, LocalWire, Send, Sink, encoded
from twin_node.runtime.zenoh_session import ZenohParameters, close_session, open_session

PUBLISHERS_REMEMBERED = 256
"""Publishers per subscription whose newest sequence number is kept; far more than a graph has of one topic."""

_open: set[ZenohWire] = set()


class ZenohWire:
    """A process's end of the network."""

    def __init__(self, parameters: ZenohParameters | None = None) -> None:
        """Raises `WireError` where zenoh is not installed, or its configuration is refused."""
        self._parameters = parameters or ZenohParameters()
        self._domain = self._parameters.domain_id
        self._session = open_session(self._parameters)
        self._local = LocalWire()
        self._numbers = itertools.count()
        self._nodes: dict[str, NodeIdentity] = {}
        self._senders: dict[tuple[str, str], _Sender] = {}
        self._desk = ServiceDesk()
        self._kept: list[Any] = []
        self._graph: dict[str, Endpoint] = {}
        self._is_watching = False
        self._lock = threading.Lock()
        self._is_closed = False
        _open.add(self)
        _close_at_the_end()
        self.refused = 0
        """Samples that came out of order."""

    @property
    def namespace(self) -> str:
        """Of all its nodes."""
        return self._parameters.namespace

    def publisher(self, node: str, topic: str, kind: TopicKind) -> Send:
        """A function that sends messages to this process by reference, and to others where any listens."""
        send_here = self._local.publisher(node, topic, kind)
        if kind.msgtype is None:
            return send_here
        known = self._senders.get((node, topic))
        if known is not None:
            return known
        sender = _Sender(send_here, lambda message: self._remote_publisher(node, topic, kind, message))
        return self._senders.setdefault((node, topic), sender)

    def advertise(self, node: str, topic: str, kind: TopicKind) -> None:
        """Declares the publisher for other processes, which is else declared when something is sent."""
        self.publisher(node, topic, kind)
        sender = self._senders.get((node, topic))
        if sender is not None:
            sender.there()

    def is_heard(self, node: str, topic: str, kind: TopicKind) -> bool:
        """Whether anybody would get what node `node` sends on `topic`, as far as this session has been told."""
        self.publisher(node, topic, kind)
        sender = self._senders.get((node, topic))
        return self._local.is_heard(node, topic, kind) or (sender is not None and sender.there().is_heard)

    def subscribe(self, node: str, topic: str, kind: TopicKind, sink: Sink) -> Cancel:
        """Hands every message on `topic` to `sink`: this process's by reference, those of others as `Encoded`."""
        cancel_here = self._local.subscribe(node, topic, kind, sink)
        if kind.msgtype is None:
            return cancel_here
        endpoint = self._endpoint(EntityKind.SUBSCRIBER, node, topic, kind, self._hash_of(kind))
        receive = _Receiver(self, kind.msgtype, sink)
        key = topic_key(self._domain, topic, kind.msgtype, endpoint.type_hash)
        subscriber = self._keep(self._declare_subscriber(key, kind, receive))
        token = self._announce(endpoint_token(endpoint))

        def cancel() -> None:
            cancel_here()
            self._drop(subscriber)
            self._drop(token)

        return cancel

    def serve(self, node: str, name: str, service: ServiceType, answer: Answer) -> Cancel:
        """Answers as node `node` what other processes ask of the service `name`, until cancelled.

        `name`: without the namespace.
        """
        name = within(self.namespace, name)
        type_hash = self._parameters.spoken(service.type_hash)
        kind = TopicKind(service.name, RELIABLE)
        endpoint = self._endpoint(EntityKind.SERVICE, node, name, kind, type_hash)
        key = topic_key(self._domain, name, service.name, type_hash)
        queryable = self._keep(self._desk.open(self._session, key, service, answer))
        token = self._announce(endpoint_token(endpoint))

        def cancel() -> None:
            self._drop(queryable)
            self._drop(token)

        return cancel

    def endpoints(self) -> tuple[Endpoint, ...]:
        """What nodes of the domain send, hear, serve and ask, as far as this session has been told.

        It is told from the first call on; sessions on other hosts take a round trip to be seen.
        """
        if not self._is_watching:
            self._is_watching = True
            everything = f"{ADMIN_SPACE}/{self._domain}/**"
            self._keep(self._session.liveliness().declare_subscriber(everything, self._on_token, history=True))
        with self._lock:
            found = tuple(self._graph.values())
        return tuple(sorted(found, key=lambda e: (e.topic, e.kind.value, e.node.name)))

    def _on_token(self, sample: Any) -> None:
        import zenoh

        token = str(sample.key_expr)
        endpoint = parse_token(token)
        with self._lock:
            if sample.kind == zenoh.SampleKind.DELETE:
                self._graph.pop(token, None)
            elif endpoint is not None:
                self._graph[token] = endpoint

    def close(self) -> None:
        """Ends all traffic and takes this process's tokens from the graph."""
        if self._is_closed:
            return
        self._is_closed = True
        _open.discard(self)
        self._local.close()
        self._desk.close()
        with self._lock:
            kept, self._kept = self._kept, []
        for entity in reversed(kept):
            entity.undeclare()
        close_session(self._session)

    def _remote_publisher(self, node: str, topic: str, kind: TopicKind, message: Any) -> _RemotePublisher:
        type_hash = self._hash_of(kind, message)
        endpoint = self._endpoint(EntityKind.PUBLISHER, node, topic, kind, type_hash)
        token = endpoint_token(endpoint)
        key = topic_key(self._domain, topic, endpoint.msgtype, endpoint.type_hash)
        publisher = self._keep(self._declare_publisher(key, kind))
        self._announce(token)
        return _RemotePublisher(publisher, gid_of(token), kind.qos.latched)

    def _declare_publisher(self, key: str, kind: TopicKind) -> Any:
        import zenoh
        from zenoh import ext

        remote, drop = zenoh.Locality.REMOTE, zenoh.CongestionControl.DROP
        if not kind.qos.latched:
            return self._session.declare_publisher(key, congestion_control=drop, allowed_destination=remote)
        # Late subscribers ask for what is cached. A message that does not come anew may not be lost to congestion; one
        # that does may: a reader that hangs would hold up the publisher by five seconds.
        return ext.declare_advanced_publisher(
            self._session,
            key,
            congestion_control=drop if kind.qos.repeats else zenoh.CongestionControl.BLOCK,
            allowed_destination=remote,
            cache=ext.CacheConfig(kind.qos.depth),
            publisher_detection=True,
        )

    def _declare_subscriber(self, key: str, kind: TopicKind, receive: _Receiver) -> Any:
        import zenoh
        from zenoh import ext

        remote = zenoh.Locality.REMOTE
        if not kind.qos.latched:
            return self._session.declare_subscriber(key, receive, allowed_origin=remote)
        history = ext.HistoryConfig(detect_late_publishers=True, max_samples=kind.qos.depth)
        return ext.declare_advanced_subscriber(self._session, key, receive, allowed_origin=remote, history=history)

    def _endpoint(self, kind: EntityKind, node: str, topic: str, carries: TopicKind, type_hash: str) -> Endpoint:
        identity = self._identity(node)
        msgtype = carries.msgtype or ""
        return Endpoint(kind, identity, next(self._numbers), topic, msgtype, type_hash, carries.qos)

    def _identity(self, name: str) -> NodeIdentity:
        with self._lock:
            identity = self._nodes.get(name)
            if identity is not None:
                return identity
            session = str(self._session.info.zid())
            identity = NodeIdentity(session, next(self._numbers), name, self.namespace, self._domain)
            self._nodes[name] = identity
        self._announce(node_token(identity))
        return identity

    def _hash_of(self, kind: TopicKind, message: Any = None) -> str:
        if not self._parameters.speaks_hashes:
            return HUMBLE_HASH  # of types that are not known here, too
        if kind.type_hash is not None:
            return kind.type_hash
        types = message.types if isinstance(message, Encoded) else builtin_types()
        return types.type_hash(kind.msgtype or "")

    def _announce(self, token: str) -> Any:
        return self._keep(self._session.liveliness().declare_token(token))

    def _drop(self, entity: Any) -> None:
        with self._lock:
            if entity not in self._kept:
                return
            self._kept.remove(entity)
        entity.undeclare()

    def _keep(self, entity: Any) -> Any:
        with self._lock:
            self._kept.append(entity)
        return entity


class _Sender:
    """Sends to this process by reference, and to others, for whom a publisher is declared when it is first needed.

    In any thread: what a player plays may be on a topic of its node's own (`/diagnostics`, `/rosout`).
    """

    def __init__(self, send_here: Send, declare: Callable[[Any], _RemotePublisher]) -> None:
        """`declare(message)`: declares the publisher; what is encoded brings its own types."""
        self._send_here = send_here
        self._declare = declare
        self._there: _RemotePublisher | None = None
        self._lock = threading.Lock()

    def there(self, message: Any = None) -> _RemotePublisher:
        """The publisher for other processes."""
        with self._lock:
            if self._there is None:
                self._there = self._declare(message)
            return self._there

    def __call__(self, message: Any) -> None:
        there = self.there(message)
        self._send_here(message)
        there(message)


class _RemotePublisher:
    """Serialises and puts, where anybody listens; in the order of its numbers, or what is put late is refused."""

    def __init__(self, publisher: Any, gid: bytes, latched: bool) -> None:
        self._publisher = publisher
        self._gid = gid
        self._latched = latched
        self._sequence = 0
        self._lock = threading.Lock()

    @property
    def is_heard(self) -> bool:
        """Whether another process listens; what is latched, one may that comes later."""
        return self._latched or bool(self._publisher.matching_status.matching)

    def __call__(self, message: Any) -> None:
        with self._lock:
            self._sequence += 1
            if not self.is_heard:
                return
            attachment = Attachment(self._sequence, time.time_ns(), self._gid).pack()
            self._publisher.put(bytes(encoded(message).data), attachment=attachment)


class _Receiver:
    """Takes samples in zenoh's threads; refuses those that are older than one that has come."""

    def __init__(self, wire: ZenohWire, msgtype: str, sink: Sink) -> None:
        self._wire = wire
        self._msgtype = msgtype
        self._sink = sink
        self._newest: dict[bytes, int] = {}

    def __call__(self, sample: Any) -> None:
        attachment = unpack_attachment(sample.attachment.to_bytes()) if sample.attachment is not None else None
        if attachment is not None and not self._advances(attachment):
            self._wire.refused += 1
            return
        self._sink(Encoded(self._msgtype, sample.payload.to_bytes()))

    def _advances(self, attachment: Attachment) -> bool:
        if attachment.sequence <= self._newest.get(attachment.gid, -1):
            return False
        self._newest[attachment.gid] = attachment.sequence
        while len(self._newest) > PUBLISHERS_REMEMBERED:
            del self._newest[next(iter(self._newest))]
        return True


@cache
def _close_at_the_end() -> None:
    """Has wires that are still open closed when the program ends.

    Python waits for zenoh's threads that call back before it does what `atexit` was told: those end with their session.
    """
    thread = threading.Thread(target=_close_after_main, name="end of wires", daemon=True)
    thread.start()
    atexit.register(thread.join)


def _close_after_main() -> None:
    threading.main_thread().join()
    for wire in tuple(_open):
        wire.close()
