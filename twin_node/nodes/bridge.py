"""Hands messages from the thread that reads a log or the cameras to the thread that works on them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from twin_node.runtime.arrivals import Arrivals
from twin_node.scene import FrameSet


class Bridge:
    """One slot for frame sets, in which the newest wins, and a queue in order for everything else, which is small."""

    def __init__(
        self,
        on_dropped: Callable[[FrameSet], None],
        patience: float = 0.0,
        time_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """`on_dropped(frames)` is called, in the reading thread, for every set that a newer one has replaced.

        `patience`: how long a set is left for the next one, see `runtime.arrivals`; 0: not at all. `time_s`: the clock
        of the arrivals.
        """
        self._on_dropped = on_dropped
        self._arrivals = Arrivals(patience)
        self._time_s = time_s
        self._condition = threading.Condition()
        self._frames: FrameSet | None = None
        self._messages: list[tuple[str, Any]] = []
        self._closed = False
        self._error: BaseException | None = None
        self.dropped = 0

    def put(self, topic: str, message: Any) -> None:
        """Queue a message that must not be lost."""
        with self._condition:
            self._messages.append((topic, message))

    def put_frames(self, frames: FrameSet) -> None:
        """Offer a frame set; one that still waits is dropped."""
        with self._condition:
            self._arrivals.add(self._time_s())
            replaced, self._frames = self._frames, frames
            self._condition.notify()
        if replaced is not None:
            self.dropped += 1
            self._on_dropped(replaced)

    def close(self, error: BaseException | None = None) -> None:
        """No more will come; `error` is raised in the working thread."""
        with self._condition:
            self._closed = True
            self._error = error
            self._condition.notify()

    @property
    def is_waiting(self) -> bool:
        """Whether a frame set waits to be taken now."""
        return self._frames is not None and not self._worth_waiting_s()

    @property
    def is_closed(self) -> bool:
        """Whether either side has closed the bridge."""
        return self._closed

    def batches(self) -> Iterator[tuple[list[tuple[str, Any]], FrameSet]]:
        """Waits for frame sets; yields each with the messages that came before it. Ends when the bridge is closed."""
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._frames is not None or self._closed)
                while wait_s := self._worth_waiting_s():
                    self._condition.wait(wait_s)
                frames, self._frames = self._frames, None
                messages, self._messages = self._messages, []
                error = self._error
            if error is not None:
                raise error
            if frames is None:
                return
            yield messages, frames

    def _worth_waiting_s(self) -> float:
        """How long to wait at most for a newer set than the one that waits, s."""
        return 0.0 if self._closed else self._arrivals.worth_waiting_s(self._time_s())
