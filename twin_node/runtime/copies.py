"""Copies of things for another process. Large arrays go through its pipe as they lie in memory: to pickle them would
take two copies more."""

from __future__ import annotations

import io
import os
import pickle
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

LARGE = 1 << 15
"""Bytes of an array from which on it is sent apart: a call per array costs as much as copying so many."""

MakeUnpickler = Callable[..., pickle.Unpickler]
"""Called as `pickle.Unpickler` is."""


def send(connection: Connection, thing: object, make_pickler: Callable[..., pickle.Pickler] = pickle.Pickler) -> None:
    """Sends a copy: torch has told the connection's own `send` to share tensors between the processes instead.

    `make_pickler` is called as `pickle.Pickler` is, and whoever receives it reads by what belongs to it.
    """
    arrays: list[memoryview] = []

    def stays(array: pickle.PickleBuffer) -> bool:
        raw = array.raw()
        if raw.nbytes >= LARGE:
            arrays.append(raw)
        return raw.nbytes < LARGE

    rest = io.BytesIO()
    make_pickler(rest, pickle.HIGHEST_PROTOCOL, buffer_callback=stays).dump(thing)
    connection.send_bytes(np.array([array.nbytes for array in arrays], np.int64).tobytes())
    connection.send_bytes(rest.getbuffer())
    for array in arrays:
        _write(connection.fileno(), array)


def receive(connection: Connection, make_unpickler: MakeUnpickler = pickle.Unpickler) -> Any:
    """What was sent next, waited for.

    Raises `EOFError` where the other end is closed, also within a message, and `BlockingIOError` where the connection
    is not waited for any longer.
    """
    try:
        sizes = np.frombuffer(connection.recv_bytes(), np.int64).tolist()
        rest = connection.recv_bytes()
        arrays = [np.empty(size, np.uint8) for size in sizes]
        for array in arrays:
            _read(connection.fileno(), array.data)
    except BlockingIOError:
        raise
    except OSError as error:
        raise EOFError from error
    return make_unpickler(io.BytesIO(rest), buffers=arrays).load()


def _write(to: int, left: memoryview) -> None:
    while left.nbytes:
        left = left[os.write(to, left) :]


def _read(of: int, left: memoryview) -> None:
    while left.nbytes:
        count = os.readv(of, [left])
        if count == 0:
            raise EOFError
        left = left[count:]
