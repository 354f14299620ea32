"""What a live node does in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable


class OwnThread:
    """Runs a node's work while the node is active.

    What ends it before its time ends the process, which would else live on silent, and is raised by `check`.
    """

    def __init__(self, name: str, work: Callable[[], None], finish: Callable[[], None]) -> None:
        """`finish()` ends the process."""
        self._name = name
        self._work = work
        self._finish = finish
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    def start(self) -> None:
        """Begins the work."""
        self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
        self._thread.start()

    def join(self) -> None:
        """Waits for the work to end, which has been asked to; at once where it never began."""
        if self._thread is not None:
            self._thread.join()

    def check(self) -> None:
        """Raises what ended the work, whatever it is."""
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as error:
            self._error = error
            self._finish()
