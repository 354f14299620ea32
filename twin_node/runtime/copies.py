"""Copies of things for another process. Large arrays go through its pipe as they lie in memory: to pickle them would
take two copies more."""

from __future__ import annotations

import io
import os
import pickle
import socket
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

LARGE = 1 << 17
"""Bytes of an array from which on it is sent apart, which takes two calls more: half of an image of 320 x 240."""
MOST_AT_ONCE = 512
"""Arrays that one call may pass; systems take 1024."""

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
    sizes = np.array([len(arrays), *(array.nbytes for array in arrays)], np.int64)
    connection.send_bytes(sizes.tobytes() + rest.getbuffer())
    if arrays:
        with _socket_of(connection) as end:
            _pass(arrays, end.sendmsg)


def receive(connection: Connection, make_unpickler: MakeUnpickler = pickle.Unpickler) -> Any:
    """What was sent next, waited for.

    Raises `EOFError` where the other end is closed, also within a message, and `BlockingIOError` where the connection
    is not waited for any longer.
    """
    try:
        come = connection.recv_bytes()
        count = int(np.frombuffer(come, np.int64, 1)[0])
        sizes = np.frombuffer(come, np.int64, 1 + count)
        arrays = [np.empty(size, np.uint8) for size in sizes[1:].tolist()]
        if arrays:
            with _socket_of(connection) as end:
                _pass([array.data for array in arrays], lambda left: end.recvmsg_into(left, 0, socket.MSG_WAITALL)[0])
    except BlockingIOError:
        raise
    except OSError as error:
        raise EOFError from error
    rest = io.BytesIO(come)
    rest.seek(sizes.nbytes)
    return make_unpickler(rest, buffers=arrays).load()


def _socket_of(connection: Connection) -> socket.socket:
    """What a pipe for both ways is made of. To be closed: the connection stays as it is."""
    return socket.socket(fileno=os.dup(connection.fileno()))


def _pass(arrays: Sequence[memoryview], some: Callable[[list[memoryview]], int]) -> None:
    """Lets `some` send or receive more of what is left, which says how many bytes it has passed, until all has been.

    In as few calls as can be: after each a thread waits until another lets it have the interpreter.
    """
    left = list(arrays)
    while left:
        count = some(left[:MOST_AT_ONCE])
        if count == 0:
            raise EOFError
        while left and count >= left[0].nbytes:
            count -= left.pop(0).nbytes
        if count:
            left[0] = left[0][count:]
