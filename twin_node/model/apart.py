"""A window model that follows what sets show in a process of its own, so that nobody waits for it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

import numpy as np

from twin_node.errors import TwinError
from twin_node.native_library import processors, thread_count
from twin_node.scene import GaussianCloud, NodeStates, TwinState

if TYPE_CHECKING:
    from twin_node.model.window_model import WindowModel

READY = "ready"
"""What the process says first: it has loaded all that it needs."""
GRACE_S = 2.0
"""How long the process may take to end when it is told to, s, before it is killed."""


class EndedError(RuntimeError):
    """The process has ended before it was told to: no fault of a set, as a `TwinError` is, and no other will do."""


def is_worth_it() -> bool:
    """Whether there is a processor for such a process: with only one it would take the time of who hands it sets.

    Nowhere but on POSIX: a file descriptor is handed on.
    """
    return processors() > 1 and os.name == "posix"


@dataclass(frozen=True)
class Followed:
    """What the process says of a set that it has followed."""

    gaussians: GaussianCloud
    nodes: NodeStates
    warnings: tuple[str, ...]
    parameters_count: int
    """See `WindowModel.parameters_count`."""
    peak_rss_mb: float
    """Most memory that the process has held so far, MB."""


@dataclass(frozen=True)
class Failed:
    """What the process says where something went wrong with a set."""

    error: TwinError | str
    """What it was, and it goes on with the next; or where nothing given to it explains it the trace, and it ends."""


def send(connection: Connection, thing: object) -> None:
    """Sends a copy: torch has told the connection's own `send` to share tensors between the processes instead."""
    connection.send_bytes(pickle.dumps(thing, pickle.HIGHEST_PROTOCOL))


class Apart:
    """The process as those who hand it sets see it: it is begun at once, and is given its model once it has loaded.

    One set at a time: `follow` hands over what a model's `look` has seen, `result` is there when that is followed.
    Until the next it refines what stands still. It takes half of the threads of this process.
    """

    def __init__(self) -> None:
        ours, its = multiprocessing.Pipe()
        environment = {**os.environ, "OMP_NUM_THREADS": str(max(1, thread_count() // 2))}
        command = [sys.executable, "-m", "twin_node.model.apart_process", str(its.fileno())]
        with its:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, pass_fds=(its.fileno(),), env=environment
            )
        self._connection: Connection = ours
        self._is_loaded = False
        self._seen: TwinState | None = None
        """What it follows now."""
        self.has_model = False
        self.parameters_count = 0
        """Numbers that described the scene after the newest result, see `WindowModel.parameters_count`."""
        self.peak_rss_mb = 0.0
        """Most memory that the process had held by then, MB."""

    @property
    def pid(self) -> int:
        """Process identifier."""
        return self._process.pid

    def is_loaded(self, wait: bool = False) -> bool:
        """Whether a model can be handed over; with `wait` once it can. Raises `EndedError`."""
        if not self._is_loaded and (wait or self._connection.poll()):
            self._receive()
            self._is_loaded = True
        return self._is_loaded

    def take(self, model: WindowModel) -> None:
        """Hands over a model that has followed its first set, as it is now: some tens of milliseconds.

        `model` goes on to `look`, and hears of what has become of its copy: see `WindowModel.hear_of`.
        """
        self._send(model)
        self.has_model = True
        self.parameters_count = model.parameters_count

    @property
    def is_free(self) -> bool:
        """Whether it can be given a set: it has a model, and the result of the set before has been asked for."""
        return self.has_model and self._seen is None

    def follow(self, seen: TwinState) -> None:
        """Hands over what was seen; only while it is free. Raises `EndedError`."""
        self._send(replace(seen, gaussians=seen.gaussians.only(np.empty(0, np.int64))))
        self._seen = seen

    def result(self, wait: bool = False) -> TwinState | None:
        """What it was given last, with the model of now; None where it has not come so far, or has been given nothing.

        With `wait` once it has come. Raises the `TwinError` that following raises, and `EndedError`.
        """
        seen = self._seen
        if seen is None or not (wait or self._connection.poll()):
            return None
        self._seen = None
        followed = self._receive()
        assert isinstance(followed, Followed)
        self.parameters_count, self.peak_rss_mb = followed.parameters_count, followed.peak_rss_mb
        return replace(
            seen, gaussians=followed.gaussians, nodes=followed.nodes, warnings=followed.warnings, followed=None
        )

    def close(self) -> None:
        """Ends the process; what it has not said by now is lost."""
        self._connection.close()
        try:
            self._process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _send(self, thing: object) -> None:
        with self._gone_is_told():
            send(self._connection, thing)

    def _receive(self) -> object:
        with self._gone_is_told():
            said = self._connection.recv()
        if not isinstance(said, Failed):
            return said
        if isinstance(said.error, TwinError):
            raise said.error
        raise EndedError(f"the model's process failed:\n{said.error}")

    @contextlib.contextmanager
    def _gone_is_told(self) -> Iterator[None]:
        try:
            yield
        except (EOFError, OSError):
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(GRACE_S)
            raise EndedError(
                f"model: expected its process ({self.pid}) to go on, found that it has ended with status "
                f"{self._process.returncode}; see what it has said before, give it more memory, or set own_process of "
                "'model' to false"
            ) from None
