"""How a command ends that is told to: in order, so that nothing half-written is left behind."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

SIGNALS = (signal.SIGTERM, signal.SIGHUP)
"""Of `kill`, `timeout`, `docker stop` and systemd; of a terminal that was closed."""

GRACE_S = 10.0
"""After this a command that goes on (what loads for seconds may swallow what it raised) ends at once, s."""


class Terminated(BaseException):
    """A command has been told to end, as by Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.status = 128 + number
        """What shells take for the exit status of a process that a signal has ended."""


@contextlib.contextmanager
def ended_in_order() -> Iterator[None]:
    """`SIGNALS` raise `Terminated` where they would end the process at once; a second one, and `GRACE_S`, do so.

    A signal that is ignored (`nohup`) stays so, and a command may set handlers of its own.
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
        yield
    finally:
        for timer in timers:
            timer.cancel()
        for number, handler in before.items():
            signal.signal(number, handler)


def ended_by(number: int) -> BaseException:
    """What a signal that ends a command raises."""
    return KeyboardInterrupt() if number == signal.SIGINT else Terminated(number)
