"""Services over zenoh as rmw_zenoh has them: a server is a queryable, a request a query, and each has an attachment.

Source: `rmw_service_data.cpp` and `rmw_client_data.cpp` of ros2/rmw_zenoh.
"""

from __future__ import annotations

import queue
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeAlias

from twin_node.messages import Message, MessageError
from twin_node.messages.services import ServiceType
from twin_node.runtime.qos import ORDER
from twin_node.runtime.rmw_zenoh import (
    ADMIN_SPACE,
    Attachment,
    EntityKind,
    node_of_token,
    parse_token,
    topic_key,
    unpack_attachment,
)
from twin_node.runtime.zenoh_session import ZenohParameters, close_session, open_client

Reply: TypeAlias = Callable[[Message], None]
"""Takes the response to a request, once; at once or later, in any thread."""
Answer: TypeAlias = Callable[[Message, Reply], None]
"""Answers a request. It is called in a thread that all services of a process share, so it must be quick."""

PATIENCE_S = ORDER.lifespan_s
"""How long a client waits for a response, s: as long as an order is good for, and as rmw_zenoh does."""
_LOOK_S = 0.1
"""Between two looks for a service that is awaited, s."""


class ServiceDesk:
    """Answers, in a thread of its own, what others ask of this process's nodes."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def open(self, session: Any, key: str, service: ServiceType, answer: Answer) -> Any:
        """A queryable that has `answer` asked whatever comes under a key; a request that is none gets no response."""
        from zenoh import handlers

        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="services", daemon=True)
            self._thread.start()

        def take(query: Any) -> None:
            self._waiting.put(lambda: _answer(query, key, service, answer))

        return session.declare_queryable(key, handlers.Callback(take, indirect=False), complete=True)

    def close(self) -> None:
        """Answers nobody any more."""
        self._waiting.put(None)

    def _work(self) -> None:
        while (do := self._waiting.get()) is not None:
            try:
                do()
            except Exception:  # of one request: who asks next is answered, and the process's log holds the trace
                traceback.print_exc()


def _answer(query: Any, key: str, service: ServiceType, answer: Answer) -> None:
    import zenoh

    asked = unpack_attachment(query.attachment.to_bytes()) if query.attachment is not None else None
    payload = query.payload.to_bytes() if query.payload is not None else b""
    try:
        request = service.types.deserialize(payload, service.request)
    except MessageError:
        request = None
    if asked is None or request is None:  # no client of rmw_zenoh: it need not wait
        query.drop()
        return

    def reply(response: Message) -> None:
        attachment = Attachment(asked.sequence, time.time_ns(), asked.gid).pack()
        with suppress(zenoh.ZError):  # the session has ended, and with it whoever waited
            query.reply(key, bytes(service.types.serialize(response)), attachment=attachment)
            query.drop()  # nothing more comes: who asks need not wait

    try:
        answer(request, reply)
    except BaseException:
        query.drop()
        raise


class ServiceClient:
    """Asks nodes of the graph, other programs' too; for as long as it is open."""

    def __init__(self, parameters: ZenohParameters) -> None:
        """Raises `NoRouterError` where no router answers, `WireError` where zenoh is not installed."""
        self._parameters = parameters
        self._session = open_client(parameters)
        self._asked = 0

    def nodes(self) -> tuple[str, ...]:
        """Full names of the nodes that are alive in the domain, sorted: `/twin`."""
        return tuple(sorted({name for token in self._tokens() if (name := node_of_token(token)) is not None}))

    def services(self) -> frozenset[str]:
        """Full names of the services that nodes of the domain serve: `/twin/get_state`."""
        ends = map(parse_token, self._tokens())
        return frozenset(end.topic for end in ends if end is not None and end.kind is EntityKind.SERVICE)

    def awaits(self, name: str, patience_s: float) -> bool:
        """Whether a node serves `name` by now, or comes to within that time, s, as one that is just being started."""
        until = time.monotonic() + patience_s
        while name not in self.services():
            if time.monotonic() >= until:
                return False
            time.sleep(_LOOK_S)
        return True

    def _tokens(self) -> list[str]:
        """Liveliness tokens of the domain."""
        pattern = f"{ADMIN_SPACE}/{self._parameters.domain_id}/**"
        return [str(reply.ok.key_expr) for reply in self._session.liveliness().get(pattern) if reply.ok is not None]

    def ask(self, name: str, service: ServiceType, patience_s: float = PATIENCE_S, **fields: object) -> Message | None:
        """The response of the service `name` to a request of these fields; None where none comes in that time.

        Raises `MessageError` where what comes is none.
        """
        import zenoh

        self._asked += 1
        key = topic_key(self._parameters.domain_id, name, service.name, self._parameters.spoken(service.type_hash))
        attachment = Attachment(self._asked, time.time_ns(), bytes.fromhex(str(self._session.info.zid()).zfill(32)))
        replies = self._session.get(
            key,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            payload=bytes(service.types.serialize(service.ask(**fields))),
            attachment=attachment.pack(),
            timeout=patience_s,
        )
        for reply in replies:
            if reply.ok is not None:
                return service.types.deserialize(reply.ok.payload.to_bytes(), service.response)
        return None

    def close(self) -> None:
        """Ends the session."""
        close_session(self._session)
