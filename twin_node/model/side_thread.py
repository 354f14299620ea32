"""Compiled work that another thread does meanwhile, if it comes to it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, Generic, TypeVar

from twin_node.native_library import kernel_threads, thread_count
from twin_node.splat.library import kernels, limit_torch

Result = TypeVar("Result")


class Begun(Generic[Result]):
    """Work that has been begun, or that is done when it is asked for."""

    def __init__(self, work: Callable[[], Result], done: Future[Result] | None) -> None:
        self._work = work
        self._done = done

    @property
    def is_done(self) -> bool:
        """Whether nobody need wait for it."""
        return self._done is not None and self._done.done()

    def end(self) -> Result:
        """What it comes to, waited for, or found here where nobody has begun; called once. Raises as the work does."""
        if self._done is None or self._done.cancel():
            return self._work()
        return self._done.result()

    def __reduce__(self) -> tuple[Any, ...]:
        """In another process: what it comes to, for what it is made of may be changed once it has its end."""
        return Begun, (partial(_itself, self.end()), None)


class SideThread:
    """A thread beside the one that asks. Worth it for compiled calls, which leave the interpreter to others."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(1, "side", initializer=_keep_torch_alone)

    def begin(self, work: Callable[[], Result]) -> Begun[Result]:
        """Hands `work` over, which must touch nothing that anybody changes before its end.

        Its kernels and torch's loops take one thread, so that those of others find theirs. Where there is one thread at
        all (see `thread_count`) it is done when it is asked for.
        """
        return Begun(work, self._threads.submit(_alone, work) if thread_count() > 1 else None)

    def __reduce__(self) -> tuple[Any, ...]:
        """In another process: another thread."""
        return SideThread, ()


def _itself(result: Result) -> Result:
    return result


def _keep_torch_alone() -> None:
    if kernels() is not None:
        limit_torch(1)


def _alone(work: Callable[[], Result]) -> Result:
    with kernel_threads(1):
        return work()
