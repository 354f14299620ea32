"""How a command ends that is told to: in order, so that nothing half-written is left behind."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from importlib.machinery import ExtensionFileLoader
from types import FrameType

SIGNALS = (signal.SIGTERM, signal.SIGHUP)
"""Of `kill`, `timeout`, `docker stop` and systemd; of a terminal that was closed."""

GRACE_S = 10.0
"""After this a command that goes on (what loads for seconds may swallow what it raised) ends at once, s."""

AGAIN_S = 0.05
"""How soon an interrupt that came while a compiled module loads is raised again, s."""


class Terminated(BaseException):
    """A command has been told to end, as by Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.status = 128 + number
        """What shells take for the exit status of a process that a signal has ended."""


@contextlib.contextmanager
def ended_in_order() -> Iterator[None]:
    """`SIGNALS` raise `Terminated` where they would end the process at once; a second one, and `GRACE_S`, do so.

    Ctrl-C waits while a compiled module loads, for `GRACE_S` at most. A signal that is ignored (`nohup`) stays so, and
    a command may set handlers of its own.
    """
    before, timers = {}, list[threading.Timer]()

    def end(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        timers.append(threading.Timer(GRACE_S, os.kill, (os.getpid(), number)))
        timers[-1].daemon = True
        timers[-1].start()
        raise Terminated(number)

    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in SIGNALS}
    for number, handler in before.items():
        if handler is signal.SIG_DFL:
            signal.signal(number, end)
    try:
        with _interrupts_not_lost():
            yield
    finally:
        for timer in timers:
            timer.cancel()
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _interrupts_not_lost() -> Iterator[None]:
    """Ctrl-C is raised where it gets through: a compiled module that is being loaded may swallow it.

    The alarm clock looks again, which Python itself leaves to whoever wants it.
    """
    numbers = (signal.SIGINT, signal.SIGALRM)
    if threading.current_thread() is not threading.main_thread() or [*map(signal.getsignal, numbers)] != [
        signal.default_int_handler,
        signal.SIG_DFL,
    ]:
        yield
        return
    since: float | None = None

    def interrupt(_number: int, frame: FrameType | None) -> None:
        nonlocal since
        since = time.monotonic() if since is None else since
        if _swallows(frame) and time.monotonic() - since < GRACE_S:
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
            return
        signal.setitimer(signal.ITIMER_REAL, 0)
        since = None
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _swallows(frame: FrameType | None) -> bool:
    """Whether what is raised where a signal has come may be lost.

    So it is within a compiled module that loads, and where Python's own machinery clears up after a module. A module's
    body may be in compiled code that sets up its own part, as torch's are: what is raised there aborts the process.
    """
    if frame is not None and (_is_of_imports(frame) or _is_module_body(frame)):
        return True
    while frame is not None:
        if _is_of_imports(frame) and isinstance(frame.f_locals.get("self"), ExtensionFileLoader):
            return True
        frame = frame.f_back
    return False


def _is_of_imports(frame: FrameType) -> bool:
    return frame.f_code.co_filename.startswith("<frozen importlib")


def _is_module_body(frame: FrameType) -> bool:
    return frame.f_code.co_name == "<module>" and frame.f_back is not None and _is_of_imports(frame.f_back)


def ended_by(number: int) -> BaseException:
    """What a signal that ends a command raises."""
    return KeyboardInterrupt() if number == signal.SIGINT else Terminated(number)
