"""A window model that follows what sets show in a process of its own, so that nobody waits for it."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from twin_node.errors import TwinError
from twin_node.native_library import thread_count
from twin_node.runtime.worker_process import WorkerProcess
from twin_node.scene import GaussianCloud, NodeStates, TwinState

if TYPE_CHECKING:
    from twin_node.model.window_model import WindowModel


PATIENCE_S = 120.0
"""How long a set may take to be followed, s, before its process counts as hanging: a thousand times the usual, for a
device's code may be compiled meanwhile. What stands would be that of then for good, and nobody would know."""
LOOK_S = 1.0
"""Longest time between two looks for a result that counts as waiting, s: whoever was stopped itself has not waited."""


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


class ModelProcess:
    """The process as those who hand it sets see it: it is begun at once, and is given its model once it has loaded.

    One set at a time: `follow` hands over what a model's `look` has seen, `result` is there when that is followed.
    Until the next it refines what stands still. It takes half of the threads of this process.
    """

    def __init__(self) -> None:
        self._process = WorkerProcess(
            "twin_node.model.model_worker",
            "model",
            "give it more memory, or set own_process of 'model' to false",
            {"OMP_NUM_THREADS": str(max(1, thread_count() // 2))},
            PATIENCE_S,
        )
        self._seen: TwinState | None = None
        """What it follows now."""
        self._waited_s = 0.0
        self._looked_s = 0.0
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
        return self._process.is_loaded(wait)

    def take(self, model: WindowModel) -> None:
        """Hands over a model that has followed its first set, as it is now: some tens of milliseconds.

        `model` goes on to `look`, and hears of what has become of its copy: see `WindowModel.hear_of`. Where the one
        before was let go while it followed a set, that is waited for. Raises `EndedError`.
        """
        while self._seen is not None:
            with contextlib.suppress(TwinError):  # nobody wants to know any more
                self.result(LOOK_S)
        self._process.send(model)
        self.has_model = True
        self.parameters_count = model.parameters_count

    def let_go(self) -> None:
        """The model that it has is wanted no more: it waits for another. What it has not said by now is lost."""
        self.has_model = False

    @property
    def is_free(self) -> bool:
        """Whether it can be given a set: it has a model, and the result of the set before has been asked for."""
        return self.has_model and self._seen is None

    def follow(self, seen: TwinState) -> None:
        """Hands over what was seen; only while it is free. Raises `EndedError`."""
        self._process.send(replace(seen, gaussians=seen.gaussians.only(np.empty(0, np.int64))))
        self._seen, self._waited_s, self._looked_s = seen, 0.0, time.monotonic()

    def result(self, wait_s: float = 0.0) -> TwinState | None:
        """What it was given last, with the model of now; None where it has been given nothing, or that has not come
        within `wait_s` seconds.

        Raises the `TwinError` that following raises, and `EndedError`, also where the process hangs: it is ended then.
        """
        seen = self._seen
        if seen is None:
            return None
        if not self._process.connection.poll(wait_s):
            looked_s, self._looked_s = self._looked_s, time.monotonic()
            self._waited_s += min(self._looked_s - looked_s, LOOK_S)
            if self._waited_s > PATIENCE_S:
                self._process.give_up()
            return None
        self._seen = None
        followed = self._process.receive()
        assert isinstance(followed, Followed)
        self.parameters_count, self.peak_rss_mb = followed.parameters_count, followed.peak_rss_mb
        return replace(
            seen, gaussians=followed.gaussians, nodes=followed.nodes, warnings=followed.warnings, followed=None
        )

    def close(self) -> None:
        """Ends the process; what it has not said by now is lost."""
        self._process.close()
