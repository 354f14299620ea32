"""Work that another thread does meanwhile, if it comes to it."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import Generic, TypeVar

from twin_node.native_library import thread_count

Result = TypeVar("Result")

_SLACK_S = 1e-3
"""Who waits longer than this for an errand had a helper that was not scheduled, s."""
_MOST_ALONE = 512
"""Most errands in a row that are done without."""


class Errand(Generic[Result]):
    """Work whose result is asked for later.

    A helper does it if it has begun by then; else whoever asks does it, and waits for nobody. Pays for compiled calls
    alone, which leave the interpreter to others.
    """

    def __init__(self, work: Callable[[], Result]) -> None:
        """`work` is done once: here where there is one thread (`thread_count`), or the helper kept others waiting."""
        self._work = work
        self._found: Future[Result] = Future()
        if thread_count() > 1 and not _helper().is_dismissed():
            self._found = _helper().threads.submit(work)
        else:
            self._do()
        self._is_judged = self._found.done()

    def result(self) -> Result:
        """What came of it; raises what the work raises."""
        if self._found.cancel():
            self._found, self._is_judged = Future(), True
            self._do()
        begun = time.perf_counter()
        self._found.exception()  # waits, and raises nothing
        if not self._is_judged:
            self._is_judged = True
            _helper().judge(time.perf_counter() - begun)
        return self._found.result()

    def _do(self) -> None:
        try:
            self._found.set_result(self._work())
        except BaseException as error:  # raised where the result is asked for, as a helper's is
            self._found.set_exception(error)


class Helper:
    """One thread for all errands, which are short. A forked child has none, and does its errands itself."""

    def __init__(self) -> None:
        self.threads = ThreadPoolExecutor(1, "errands")
        self._doubt, self._alone = 0, 0

    def is_dismissed(self) -> bool:
        """Whether the next errand is one of those that are done without."""
        if self._alone == 0:
            return False
        self._alone -= 1
        return True

    def judge(self, waited_s: float) -> None:
        """Takes in how long somebody waited (s): the next errands are done without, more each time that it was long."""
        is_late = waited_s > _SLACK_S
        self._doubt = min(2 * self._doubt + 8, _MOST_ALONE) if is_late else self._doubt // 2
        self._alone = self._doubt if is_late else 0


@cache
def _helper() -> Helper:
    return Helper()
