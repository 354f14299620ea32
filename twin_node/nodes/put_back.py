"""Clocks that are put back while messages are recorded by them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from twin_node.bag.recording import PUT_BACK_NS, free_path


class PutBackClock:
    """Tells where a recording is to go on beside the one before: in one log what comes then would stand in between."""

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        """`path`: as was asked for; others have its name with a number behind. `say(line)` tells the user of them."""
        self._path = path
        self._say = say
        self._newest = 0
        """When the newest message came, ns."""

    def beside(self, stamp: int) -> Path | None:
        """Path of the recording that is to be begun with a message at a log time, ns; None: it belongs to the last."""
        back_ns, self._newest = self._newest - stamp, stamp
        if back_ns <= PUT_BACK_NS:
            return None
        path = free_path(self._path)
        self._say(f"time was put back by {back_ns / 1e9:.1f} s: what comes from now on is recorded into {path}")
        return path
