"""One thread that runs the callbacks of some nodes: messages in the order of their arrival, and timers."""

from __future__ import annotations

import heapq
import itertools
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sized
from dataclasses import dataclass, field
from typing import Any, Protocol

from twin_node.runtime.arrivals import Arrivals

SHORTEST_WAIT_S = 1e-3
"""Between two looks at a clock which may not run with the wall's (a log that is played slowly, or paused), by which
an alarm is set, s."""


class Alarm(Protocol):
    """A call that is due once, and can be put off."""

    def set(self, delay_s: float) -> None:
        """Ring `delay_s` seconds of wall time from now, and not before."""


class Timers(Protocol):
    """Where a node asks to be called again and again, or at a certain time."""

    def every(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call `callback()` every `period_s` seconds of wall time."""

    def alarm(self, callback: Callable[[], None]) -> Alarm:
        """An alarm that calls `callback()` when it rings; it is not set yet."""


class NoTimers:
    """Timers of a graph without wall time: in lockstep nothing is ever late."""

    def every(self, period_s: float, callback: Callable[[], None]) -> None:
        """Does nothing."""

    def alarm(self, callback: Callable[[], None]) -> Alarm:
        """An alarm that never rings."""
        return _SilentAlarm()


class _SilentAlarm:
    def set(self, delay_s: float) -> None:
        """Does nothing."""


@dataclass(order=True)
class _Timer:
    due: float
    order: int
    period_s: float | None = field(compare=False)
    """None: it is due once."""
    callback: Callable[[], None] = field(compare=False)


class _ExecutorAlarm:
    """Has one timer at most that will ring; one that is put off is set again when its timer comes: no timer is
    searched for, and messages that come often cost nothing."""

    def __init__(self, executor: Executor, callback: Callable[[], None]) -> None:
        self._executor = executor
        self._callback = callback
        self._due: float | None = None
        self._timer_due: float | None = None

    def set(self, delay_s: float) -> None:
        self._due = time.monotonic() + delay_s
        if self._timer_due is None or self._due < self._timer_due:
            self._set_timer(self._due)

    def _set_timer(self, due: float) -> None:
        self._timer_due = due
        self._executor.once(due, lambda: self._on_timer(due))

    def _on_timer(self, due: float) -> None:
        if due != self._timer_due or self._due is None:
            return
        if self._due > due:
            self._set_timer(self._due)
            return
        self._due = self._timer_due = None
        self._callback()


class Inbox:
    """The newest messages for one callback; when `depth` of them wait already, or too many bytes, the oldest go."""

    def __init__(
        self,
        executor: Executor,
        callback: Callable[[Any], None],
        depth: int,
        patience: float = 0.0,
        most_bytes: float = math.inf,
        lifespan_s: float = math.inf,
    ) -> None:
        """`patience`, `most_bytes` and `lifespan_s`: see `Qos`."""
        self._executor = executor
        self._callback = callback
        self._waiting: deque[tuple[Any, int, float]] = deque()
        """Messages, their bytes, and when they came by the monotonic clock, s."""
        self._bytes = 0
        self._depth = depth
        self._most_bytes = most_bytes
        self._lifespan_s = lifespan_s
        self._arrivals = Arrivals(patience)
        self.dropped = 0
        """Messages that newer ones have replaced, or that have waited too long."""

    def offer(self, message: Any) -> None:
        """Takes a message, from any thread."""
        self._executor.enqueue(self, message)

    def push(self, message: Any) -> bool:
        """Takes a message under the executor's lock; False where it replaced one that still waits, or several."""
        now = time.monotonic()
        self._arrivals.add(now)
        size, before = _bytes_of(message), self.dropped
        while self._waiting and (len(self._waiting) >= self._depth or self._bytes + size > self._most_bytes):
            self._bytes -= self._waiting.popleft()[1]
            self.dropped += 1
        self._waiting.append((message, size, now))
        self._bytes += size
        return self.dropped == before

    @property
    def is_waiting(self) -> bool:
        """Whether a message waits; from any thread."""
        return bool(self._waiting)

    def worth_waiting_s(self, now: float) -> float:
        """How long to leave what waits for a newer message, at most, s."""
        return self._arrivals.worth_waiting_s(now)

    def run(self) -> None:
        """Hands the oldest waiting message to the callback, in the executor's thread."""
        with self._executor.lock:
            if not self._waiting:
                return  # a larger one has taken the place of several
            message, size, came = self._waiting.popleft()
            self._bytes -= size
            is_over = time.monotonic() - came >= self._lifespan_s
            self.dropped += is_over
        if not is_over:
            self._callback(message)


def _bytes_of(message: Any) -> int:
    """What a message carries in its field `data`, encoded or not: of others, size does not matter."""
    data = getattr(message, "data", None)
    return len(data) if isinstance(data, Sized) else 0


class Executor:
    """Runs callbacks one at a time. `offer` and `stop` may be called from any thread, the rest from one.

    Timers that are due go first, but no two in a row while a message waits.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self.lock = self._condition
        """Held while inboxes take and give messages."""
        self._ready: deque[Inbox] = deque()
        self._timers: list[_Timer] = []
        self._order = itertools.count()
        self._was_timer = False
        self._stopped = False
        self._called: float | None = None
        """When the callback that runs now was called, s of the monotonic clock."""

    @property
    def busy_s(self) -> float:
        """For how long the callback that runs now has done so, s; 0 between two of them. From any thread."""
        called = self._called
        return 0.0 if called is None else time.monotonic() - called

    @property
    def is_stopped(self) -> bool:
        """Whether it was told to stop: a callback that takes seconds does well to look. From any thread."""
        return self._stopped

    def inbox(
        self,
        callback: Callable[[Any], None],
        depth: int,
        patience: float = 0.0,
        most_bytes: float = math.inf,
        lifespan_s: float = math.inf,
    ) -> Inbox:
        """A queue of at most `depth` messages, and `most_bytes` of those, whose `callback(message)` this executor runs.

        `patience`: how long a message is left for the next one, see `runtime.arrivals`; 0: not at all. `lifespan_s`:
        how long one may wait.
        """
        return Inbox(self, callback, depth, patience, most_bytes, lifespan_s)

    def enqueue(self, inbox: Inbox, message: Any) -> None:
        """Puts a message into one of this executor's inboxes; from any thread."""
        with self._condition:
            if inbox.push(message):
                self._ready.append(inbox)
                self._condition.notify()

    def every(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call `callback()` every `period_s` seconds; a call that is missed is not made up for."""
        self._add_timer(time.monotonic() + period_s, period_s, callback)

    def once(self, due: float, callback: Callable[[], None]) -> None:
        """Call `callback()` at a time of the monotonic clock, s."""
        self._add_timer(due, None, callback)

    def alarm(self, callback: Callable[[], None]) -> Alarm:
        """An alarm that calls `callback()`; to be set in this executor's thread."""
        return _ExecutorAlarm(self, callback)

    def clear_timers(self) -> None:
        """Forget all timers."""
        with self._condition:
            self._timers.clear()

    def stop(self) -> None:
        """Let `spin` return once the callback that runs now is done; from any thread, or from a signal handler."""
        self._stopped = True
        if self._condition.acquire(blocking=False):
            self._condition.notify_all()
            self._condition.release()

    def spin(self) -> None:
        """Run callbacks until `stop`; whatever one of them raises ends it."""
        while not self._stopped:
            self.step(MAX_WAIT_S)

    def step(self, wait_s: float) -> bool:
        """Run the next timer or message that is due within `wait_s` seconds; False where none was."""
        deadline = time.monotonic() + wait_s
        with self._condition:
            while not self._stopped:
                now = time.monotonic()
                waits = [inbox.worth_waiting_s(now) for inbox in self._ready]
                is_ready = 0.0 in waits
                is_due = bool(self._timers) and self._timers[0].due <= now
                if is_due and not (is_ready and self._was_timer):
                    callback, self._was_timer = self._next_timer(now), True
                    break
                if is_ready:
                    row = waits.index(0.0)
                    callback, self._was_timer = self._ready[row].run, False
                    del self._ready[row]
                    break
                if now >= deadline:
                    return False
                until = min(deadline, self._timers[0].due) if self._timers else deadline
                self._condition.wait(min([until - now, *waits]))
            else:
                return False
        self._called = time.monotonic()
        callback()
        self._called = None
        return True

    def _add_timer(self, due: float, period_s: float | None, callback: Callable[[], None]) -> None:
        with self._condition:
            heapq.heappush(self._timers, _Timer(due, next(self._order), period_s, callback))
            self._condition.notify()

    def _next_timer(self, now: float) -> Callable[[], None]:
        timer = self._timers[0]
        if timer.period_s is None:
            return heapq.heappop(self._timers).callback
        due = timer.due + timer.period_s
        if due <= now:
            due = now + timer.period_s
        heapq.heapreplace(self._timers, _Timer(due, next(self._order), timer.period_s, timer.callback))
        return timer.callback


MAX_WAIT_S = 0.5
"""Longest sleep of an executor without work, s: how long `stop` may go unnoticed when it interrupts the lock."""
