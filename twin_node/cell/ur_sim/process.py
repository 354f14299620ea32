"""A stand-in in a process of its own, for benchmarks and tests: faults by method, state by record."""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import random
import signal
import socket
from dataclasses import replace
from multiprocessing.connection import Connection

from twin_node.cell.errors import CellError
from twin_node.cell.ur_sim.stand_in import DASHBOARD_PORT, RTDE_PORT, StandIn, StandInParameters
from twin_node.cell.ur_sim.status import Status, from_line

_START_S = 120.0
"""Longest that a busy computer may take to start it; one that has ended is told of at once."""
_ANSWER_S = 10.0
"""Longest that it may take to answer."""


class StandInProcess:
    """Runs from construction to `close`; usable as a context."""

    def __init__(self, parameters: StandInParameters | None = None) -> None:
        """By default at a loopback address that nobody uses. Raises `CellError` where it does not start."""
        self.parameters = parameters or StandInParameters(host=free_loopback())
        if self.parameters.admin_port is None:
            raise CellError("stand-in process: expected an admin port, found none; give it one")
        context = multiprocessing.get_context("spawn")
        self._tie, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(self.parameters, theirs), daemon=True)
        self._process.start()
        theirs.close()
        try:
            problem = self._tie.recv() if self._tie.poll(_START_S) else "it did not start in time"
        except EOFError:
            problem = "its process ended"
        if problem:
            self._process.kill()
            raise CellError(f"stand-in: {problem}")
        self._admin = socket.create_connection((self.host, self.parameters.admin_port), timeout=_ANSWER_S)
        self._lines = self._admin.makefile("r")

    @property
    def host(self) -> str:
        """Its address."""
        return self.parameters.host

    def switch(self, line: str) -> None:
        """Switch a fault, as `faults.switch` takes it; raises `CellError` where it is refused."""
        answer = self._ask(line)
        if answer != "ok":
            raise CellError(answer.removeprefix("error: "))

    def status(self) -> Status:
        """How the controller is."""
        return from_line(self._ask("status"))

    def dashboard(self, order: str) -> str:
        """Send an order to its dashboard; gives back the answer."""
        with socket.create_connection((self.host, DASHBOARD_PORT), timeout=_ANSWER_S) as connection:
            connection.sendall(f"{order}\n".encode())
            with connection.makefile("r") as lines:
                lines.readline()  # the greeting
                return lines.readline().rstrip("\n")

    def kill(self) -> None:
        """End it at once (SIGKILL), as when power fails."""
        self._process.kill()
        self._process.join()

    def revived(self) -> StandInProcess:
        """A new stand-in where this one was killed, its own program not running, as after a power failure."""
        return StandInProcess(replace(self.parameters, is_playing=False, faults=()))

    def close(self) -> None:
        """End it."""
        self._lines.close()
        self._admin.close()
        self._tie.close()
        self._process.kill()
        self._process.join()

    def __enter__(self) -> StandInProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, line: str) -> str:
        self._admin.sendall(f"{line}\n".encode())
        return self._lines.readline().rstrip("\n")


def free_loopback() -> str:
    """A loopback address on which nobody listens for RTDE; the ports themselves are fixed."""
    for _ in range(100):
        host = f"127.{random.randint(64, 127)}.{random.randint(0, 255)}.{random.randint(1, 254)}"
        with socket.socket() as trial, contextlib.suppress(OSError):
            trial.bind((host, RTDE_PORT))
            return host
    raise CellError("no loopback address is free; this system seems to have 127.0.0.1 only: give a host")


def _serve(parameters: StandInParameters, tie: Connection) -> None:
    """Target of the process; tells None when all ports are open, else what is wrong, and ends with who started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: whoever started us ends us
    try:
        with contextlib.suppress(asyncio.CancelledError):
            asyncio.run(_until_alone(parameters, tie))
    except CellError as error:
        tie.send(str(error))


async def _until_alone(parameters: StandInParameters, tie: Connection) -> None:
    task = asyncio.ensure_future(StandIn(parameters).run(lambda: tie.send(None)))
    asyncio.get_running_loop().add_reader(tie.fileno(), task.cancel)  # nothing is ever sent: it reads as ended
    await task
