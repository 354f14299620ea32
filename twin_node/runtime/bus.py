"""The bus that carries messages between nodes, and the one that does so inside a process."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from twin_node.runtime.wire import Encoded, encoded

T = TypeVar("T")
Callback = Callable[[Any], None]


class Bus(Protocol):
    """Named topics, each carrying one type of message, to any number of subscribers."""

    def publish(self, topic: str, message: Any) -> None:
        """Deliver `message` to everyone who subscribes to `topic`."""

    def subscribe(self, topic: str, callback: Callback) -> None:
        """Call `callback(message)` for every message on `topic`; a latched topic's last message comes at once."""

    def subscribe_timed(self, topic: str, callback: Callable[[Encoded, T], None], now: Callable[[], T]) -> None:
        """Call `callback(encoded, came)` for every message on `topic`, undecoded.

        `came`: what `now()` said when it came, which is called in any thread; it may have waited for its callback
        since.
        """


class LocalBus:
    """Messages by reference inside one thread, delivered in the order of publication: the same run twice is the same.

    A message published from inside a callback waits until the callbacks of the one before it are done, so no callback
    is ever entered twice. Messages must not be changed after they were published.
    """

    def __init__(self, is_latched: Callable[[str], bool] = lambda topic: False) -> None:
        """`is_latched(topic)`: whether a late subscriber is given a topic's last message."""
        self._is_latched = is_latched
        self._last: dict[str, Any] = {}
        self._callbacks: dict[str, list[Callback]] = {}
        self._pending: deque[tuple[str, Any]] = deque()
        self._delivering = False

    def publish(self, topic: str, message: Any) -> None:
        """Deliver `message`, and whatever is published meanwhile, before returning (unless already delivering)."""
        self._pending.append((topic, message))
        if self._delivering:
            return
        self._delivering = True
        try:
            while self._pending:
                self._deliver(*self._pending.popleft())
        finally:
            self._delivering = False
            self._pending.clear()

    def subscribe(self, topic: str, callback: Callback) -> None:
        """Call `callback(message)` for every message on `topic`; a latched topic's last message comes at once."""
        self._callbacks.setdefault(topic, []).append(callback)
        if topic in self._last:
            callback(self._last[topic])

    def subscribe_timed(self, topic: str, callback: Callable[[Encoded, T], None], now: Callable[[], T]) -> None:
        """Call `callback(encoded, came)` for every message on `topic`, undecoded; here none waits."""
        self.subscribe(topic, lambda message: callback(encoded(message), now()))

    def _deliver(self, topic: str, message: Any) -> None:
        if self._is_latched(topic):
            self._last[topic] = message
        for callback in tuple(self._callbacks.get(topic, ())):  # who comes meanwhile has it, if it is latched
            callback(message)
