"""Work that another thread does meanwhile, if it comes to it. Pays for compiled calls, which leave the interpreter to
others."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, Generic, TypeVar

from twin_node.native_library import thread_count

Result = TypeVar("Result")

_MOST_ALONE = 512
"""Most tasks in a row that are done without a thread that came late."""


class Task(Generic[Result]):
    """Work whose result is asked for later: a side thread does it if it has begun by then, else whoever asks."""

    def __init__(
        self,
        work: Callable[[], Result],
        done: Future[Result] | None = None,
        on_waited: Callable[[float], None] | None = None,
    ) -> None:
        """`done`: by a side thread, None if there is none; `on_waited` is told how long (s) who asked waited for it."""
        self._work = work
        self._done = done
        self._on_waited = on_waited

    @property
    def is_done(self) -> bool:
        """Whether nobody need wait for it."""
        return self._done is not None and self._done.done()

    def result(self) -> Result:
        """What it comes to, the same however often it is asked for; raises what the work raises."""
        on_waited, self._on_waited = self._on_waited, None
        if self._done is None or self._done.cancel():
            self._done = _done(self._work)
        elif on_waited is not None:
            begun = time.perf_counter()
            self._done.exception()  # waits, and raises nothing
            on_waited(time.perf_counter() - begun)
        return self._done.result()

    def __reduce__(self) -> tuple[Any, ...]:
        """In another process: what it comes to, for what it is made of may be changed once it is done."""
        return Task, (partial(_itself, self.result()),)


class SideThread:
    """A thread beside the one that asks, for its tasks. In a forked child, who asks does them."""

    def __init__(self, enter: Callable[[], None] | None = None, patience_s: float = math.inf) -> None:
        """The thread calls `enter` first. Who waits for it for longer than `patience_s` does the next tasks without:
        it was not scheduled. The more so each time that happens."""
        self._enter, self._patience_s = enter, patience_s
        self._threads = ThreadPoolExecutor(1, "side", initializer=enter)
        self._doubt, self._alone = 0, 0

    def begin(self, work: Callable[[], Result]) -> Task[Result]:
        """Hands `work` over, which must touch nothing that anybody changes before its result is asked for.

        Where there is one thread at all (see `thread_count`), it is done then.
        """
        if thread_count() == 1 or self._is_dismissed():
            return Task(work)
        return Task(work, self._threads.submit(work), self._judge)

    def __reduce__(self) -> tuple[Any, ...]:
        """In another process: another thread."""
        return SideThread, (self._enter, self._patience_s)

    def _is_dismissed(self) -> bool:
        """Whether the next task is one of those that are done without."""
        if self._alone == 0:
            return False
        self._alone -= 1
        return True

    def _judge(self, waited_s: float) -> None:
        is_late = waited_s > self._patience_s
        self._doubt = min(2 * self._doubt + 8, _MOST_ALONE) if is_late else self._doubt // 2
        self._alone = self._doubt if is_late else 0


def _done(work: Callable[[], Result]) -> Future[Result]:
    """Work, done here."""
    done: Future[Result] = Future()
    try:
        done.set_result(work())
    except BaseException as error:  # raised where the result is asked for, as a thread's is
        done.set_exception(error)
    return done


def _itself(result: Result) -> Result:
    return result
