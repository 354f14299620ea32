"""A worker process: a module of this package, begun at once, spoken with over a pipe, ended with whoever began it."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import NoReturn

from twin_node.errors import TwinError
from twin_node.native_library import processors
from twin_node.runtime import copies
from twin_node.runtime.leaving import leave

READY = "ready"
"""What the process says first: it has loaded all that it needs."""
GRACE_S = 2.0
"""How long the process may take to end when it is told to, s, before it is killed."""


class EndedError(RuntimeError):
    """The process has ended before it was told to: no fault of what it was given, as a `TwinError` is."""


@dataclass(frozen=True)
class Failed:
    """What the process says where something went wrong."""

    error: TwinError | str
    """What it was; or where nothing given to it explains it the trace, and it ends."""


def is_worth_it() -> bool:
    """Whether there is a processor for such a process: with only one it would take the time of who began it.

    Nowhere but on POSIX: a file descriptor is handed on.
    """
    return processors() > 1 and os.name == "posix"


class WorkerProcess:
    """The process as whoever began it sees it."""

    def __init__(
        self,
        module: str,
        name: str,
        advice: str,
        environment: Mapping[str, str] | None = None,
        patience_s: float | None = None,
    ) -> None:
        """Begins `python -m MODULE`, which calls `run`.

        `name` and `advice`: for the error where it ends by itself. `environment`: what is else in its than here.
        `patience_s`: how long it may keep whoever hands it something, or waits for what it says once it has loaded;
        None: for ever.
        """
        self._name, self._advice = name, advice
        self.connection, its = Pipe()
        """This end of the pipe."""
        if patience_s is not None:
            _limit_waits(self.connection, patience_s)
        with its, _uninterrupted():
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, str(its.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=(its.fileno(),),
                env={**os.environ, **(environment or {})},
            )
        self._is_loaded = False

    @property
    def pid(self) -> int:
        """Process identifier."""
        return self._process.pid

    def is_loaded(self, wait: bool = False) -> bool:
        """Whether it has said that it is ready; with `wait` once it has, however long it loads. Raises as `receive`."""
        if not self._is_loaded and self.connection.poll(None if wait else 0.0):
            self.receive()
            self._is_loaded = True
        return self._is_loaded

    def send(self, thing: object) -> None:
        """Hands over a copy. Raises `EndedError`."""
        with self._gone_is_told():
            copies.send(self.connection, thing)

    def receive(self, make_unpickler: copies.MakeUnpickler = pickle.Unpickler) -> object:
        """What it says next, waited for. Raises the `TwinError` that it has met, and `EndedError`."""
        with self._gone_is_told():
            said = copies.receive(self.connection, make_unpickler)
        if not isinstance(said, Failed):
            return said
        if isinstance(said.error, TwinError):
            raise said.error
        raise EndedError(f"the {self._name}'s process failed:\n{said.error}")

    def end(self) -> None:
        """Ends it at once, whoever waits for what it says next."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """Lets it end; what it has not said by now is lost."""
        self.connection.close()
        try:
            self._process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            self.end()

    def give_up(self) -> NoReturn:
        """Ends a process that hangs. Raises `EndedError`."""
        self.end()
        raise EndedError(
            f"{self._name}: expected its process ({self.pid}) to go on, found that it hangs, and ended it; see what it "
            f"has said before, {self._advice}"
        )

    @contextlib.contextmanager
    def _gone_is_told(self) -> Iterator[None]:
        try:
            yield
        except BlockingIOError:
            self.give_up()
        except (EOFError, OSError):
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(GRACE_S)
            raise EndedError(
                f"{self._name}: expected its process ({self.pid}) to go on, found that it has ended with status "
                f"{self._process.returncode}; see what it has said before, {self._advice}"
            ) from None


def _limit_waits(connection: Connection, patience_s: float) -> None:
    """Lets sending and receiving raise `BlockingIOError` where the other end makes them wait for so long."""
    limit = struct.pack("@ll", int(patience_s), round(patience_s % 1 * 1e6))
    with socket.socket(fileno=os.dup(connection.fileno())) as end:  # options are the connection's, not its number's
        for option in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
            end.setsockopt(socket.SOL_SOCKET, option, limit)


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Processes that are begun within never hear of a Ctrl-C in their terminal, from their first moment on.

    Who has begun them ends them.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def run(work: Callable[[Connection], None]) -> NoReturn:
    """The process's own side of it: works on what comes through its end of the pipe until the other one is closed."""
    with contextlib.suppress(EOFError, ConnectionError):  # nobody hands it anything more
        work(Connection(int(sys.argv[1])))
    leave(0)
