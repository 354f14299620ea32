"""A driver's process, as its supervisor holds it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import socket
from multiprocessing.connection import wait

from twin_node.arm.ur.parameters import UrParameters
from twin_node.arm.ur.priority import ask_for_realtime
from twin_node.arm.ur.records import Begin, DriverReport, Halt, Order
from twin_node.arm.ur.worker import BRAKING_S, work

_ENDING_S = 0.5
"""How long a process may take to end in order, beside what its arm brakes."""


class DriverProcess:
    """Started ahead of need: it loads its libraries, which takes most of a second, and waits to be sent off."""

    def __init__(self, parameters: UrParameters) -> None:
        self._priority = parameters.realtime_priority
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=work, args=(parameters, theirs), name="ur_driver", daemon=True)
        self._process.start()
        theirs.close()

    @property
    def pid(self) -> int | None:
        """Its process id."""
        return self._process.pid

    def begin(self, halt: Halt | None) -> bool:
        """Let it connect, at real-time priority from now on: the arm stands until it has loaded what is not loaded yet.

        `halt` is what an earlier process left behind. False: it has died while it waited.
        """
        if self._priority and self.pid is not None:
            ask_for_realtime(self._priority, self.pid)
        return self.give(Begin(halt))

    def give(self, order: Order | Begin) -> bool:
        """Pass an order on; False: it has died."""
        try:
            self._pipe.send(order)
        except OSError:
            return False
        return True

    def hear(self, timeout_s: float) -> DriverReport | None:
        """Its next report; None: nothing within the time. Raises `EOFError` when it has ended."""
        ready = wait([self._pipe, self._process.sentinel], timeout=timeout_s)
        if self._pipe in ready:
            try:
                report: DriverReport = self._pipe.recv()
            except OSError as error:
                raise EOFError from error
            return report
        if ready:
            raise EOFError
        return None

    def hang_up(self) -> None:
        """Take no more orders: whoever waits to hand one over is let go, and the process is to end."""
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(self._pipe.fileno())) as line:
            line.shutdown(socket.SHUT_RDWR)  # to close the pipe would wake nobody

    def end(self, hangs: bool = False) -> str:
        """End it, in order if it can: it stops the arm before it goes. Gives back how it ended.

        One that `hangs` is not waited for while it might brake.
        """
        self._pipe.close()
        self._process.join(_ENDING_S if hangs else BRAKING_S + _ENDING_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        status = self._process.exitcode or 0
        self._process.close()
        return f"driver process ended by signal {-status}" if status < 0 else f"driver process ended with {status}"
