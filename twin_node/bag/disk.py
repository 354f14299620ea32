"""Puts what was written onto the disk while more is written: what a power cut takes is little then."""

from __future__ import annotations

import errno
import os
import threading
from collections import deque
from pathlib import Path

_SYNC = getattr(os, "fdatasync", os.fsync)
_CANNOT = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EACCES, errno.EPERM, errno.ENOENT)
"""Of file systems that know no such thing, folders that may be written to and not read, and what somebody took away."""


class DiskSync:
    """Syncs files and folders, one after the other, in a thread that lasts while there are any: nobody waits for it.

    `ask` and `settle` are for one thread, and raise the `OSError` that the disk has met since they were last called.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: deque[Path] = deque()
        self._thread: threading.Thread | None = None
        self._is_working = False
        self._error: OSError | None = None

    def ask(self, path: Path) -> None:
        """Have a file's content, or a folder's names, put onto the disk as they are now."""
        self._raise()
        with self._lock:
            if path not in self._waiting:
                self._waiting.append(path)
            if self._is_working:
                return
            self._is_working = True
        self._thread = threading.Thread(target=self._work, name="disk")
        self._thread.start()

    def settle(self) -> None:
        """Waits until all that was asked for is done."""
        if self._thread is not None:
            self._thread.join()
        self._raise()

    def _raise(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _work(self) -> None:
        while (path := self._next()) is not None:
            try:
                _sync(path)
            except OSError as error:  # whoever asks next raises it
                self._error = error

    def _next(self) -> Path | None:
        with self._lock:
            self._is_working = bool(self._waiting)
            return self._waiting.popleft() if self._waiting else None


def _sync(path: Path) -> None:
    try:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            _SYNC(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if error.errno not in _CANNOT:
            raise
