"""Messages of a log, read before they are due by a thread of its own."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator

from twin_node.bag import LogMessage

LONGEST_WAIT_S = 0.1
"""How long who waits may take to notice that it is to stop, s."""
MOST_BYTES = 256 * 1024 * 1024
"""Of messages that wait: a thousand raw images of some cameras are gigabytes."""


def read_ahead(messages: Iterator[LogMessage], size: int, stop: threading.Event) -> Iterator[LogMessage]:
    """The messages, read up to `size` of them or `MOST_BYTES` ahead; it ends with `stop`, and with the iteration.

    Nobody reads the log any more when the iteration has ended. Raises whatever reading it raises.
    """
    waiting = _Waiting(size, stop)

    def read() -> None:
        try:
            for message in messages:
                if not waiting.put(message, len(message.data)):
                    return
            waiting.put(None)
        except BaseException as error:  # raised again in the thread that plays, whatever it is
            waiting.put(error)

    thread = threading.Thread(target=read, name="read ahead", daemon=True)
    thread.start()
    try:
        while not stop.is_set():
            item = waiting.take()
            if isinstance(item, BaseException):
                raise item
            if item is None:
                return
            yield item
    finally:
        waiting.end()
        thread.join()


class _Waiting:
    """What has been read and is not due yet: messages, at last None or the error that ended the reading."""

    def __init__(self, size: int, stop: threading.Event) -> None:
        self._size = size
        self._stop = stop
        self._items: deque[tuple[LogMessage | BaseException | None, int]] = deque()
        self._bytes = 0
        self._is_ended = False
        self._changed = threading.Condition()

    def put(self, item: LogMessage | BaseException | None, length: int = 0) -> bool:
        """Waits until there is room; one message has it always. False where nobody takes any more."""
        with self._changed:
            while not self._has_room(length):
                if self._is_over():
                    return False
                self._changed.wait(LONGEST_WAIT_S)
            self._items.append((item, length))
            self._bytes += length
            self._changed.notify_all()
            return not self._is_over()

    def take(self) -> LogMessage | BaseException | None:
        """The next one, as soon as it has been read; None where it is to stop, too."""
        with self._changed:
            while not self._items:
                if self._is_over():
                    return None
                self._changed.wait(LONGEST_WAIT_S)
            item, length = self._items.popleft()
            self._bytes -= length
            self._changed.notify_all()
            return item

    def end(self) -> None:
        """Nobody takes any more."""
        with self._changed:
            self._is_ended = True
            self._changed.notify_all()

    def _has_room(self, length: int) -> bool:
        return not self._items or (len(self._items) < self._size and self._bytes + length <= MOST_BYTES)

    def _is_over(self) -> bool:
        return self._is_ended or self._stop.is_set()
