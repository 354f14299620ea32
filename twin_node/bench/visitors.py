"""Visitors of the viewer's page without a browser: processes that take what the page sends, and count it."""

from __future__ import annotations

import math
import multiprocessing
import os
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from twin_node.bench.errors import BenchError

PATIENCE_S = 60.0
"""Longest wait for a page or an answer, s."""
POLL_S = 0.1
"""How soon a visitor notices that it is asked, s."""
_NICENESS = 19
"""A visitor sits at another machine: here it takes only what the twin leaves."""
BYTES_PER_SPLAT = 32
"""What viser sends of a Gaussian."""
_SIZES_BYTES, _ZSTD = 16, b"\x28\xb5\x2f\xfd"
"""A message of viser's: two sizes, what it is (packed), and its arrays as they are."""


@dataclass(frozen=True)
class Sent:
    """What a visitor was sent."""

    updates: int
    """Messages of the size that was to be counted."""
    data: int
    """Bytes in all."""


class Visitor:
    """A visitor in a process of its own, so that what it does costs the page nothing but the sending."""

    def __init__(self, port: int, counted: range) -> None:
        """`counted`: sizes of the messages to be counted, bytes. It comes when the page is there."""
        spawn = multiprocessing.get_context("spawn")  # nothing may fork after OpenMP has started
        self._pipe, theirs = spawn.Pipe()
        self._process = spawn.Process(target=_visit, args=(port, counted, theirs), daemon=True)
        self._process.start()

    def wait(self) -> None:
        """Until it is on the page. Raises `BenchError` where it does not get there."""
        self._answer()

    def sent(self, updates: int = 0) -> Sent:
        """What it was sent, as soon as that holds so many updates, or the page has gone.

        Raises `BenchError` where they do not come.
        """
        self._pipe.send(updates)
        sent: Sent = self._answer()
        return sent

    def end(self) -> None:
        """Kills it."""
        self._process.kill()
        self._process.join()

    def _answer(self) -> Any:
        if not self._pipe.poll(PATIENCE_S):
            raise BenchError("viewer: expected a visitor to answer, found silence; is the machine overloaded?")
        return self._pipe.recv()


@contextmanager
def visiting(port: int, count: int, counted: range) -> Iterator[Sequence[Visitor]]:
    """So many visitors of the page on a port, as soon as it is there."""
    visitors = [Visitor(port, counted) for _ in range(count)]
    try:
        yield visitors
    finally:
        for visitor in visitors:
            visitor.end()


def free_port() -> int:
    """A port of loopback that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def connect_to(port: int) -> Any:
    """A connection to the page, in a `with`. Raises `OSError` where nobody listens."""
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    protocol = Subprotocol(f"viser-v{viser.__version__}")  # viser asks its visitors for the version that they speak
    return connect(f"ws://127.0.0.1:{port}", max_size=None, subprotocols=[protocol])


def brings_gaussians(message: bytes) -> bool:
    """Whether a message of the page's holds Gaussians; the arm's meshes are as large."""
    import zstandard

    packed = message[_SIZES_BYTES:]
    told = zstandard.ZstdDecompressor().decompressobj().decompress(packed) if packed.startswith(_ZSTD) else message
    return b"GaussianSplatsMessage" in told


def _visit(port: int, counted: range, pipe: Connection) -> None:
    """Counts until it is killed; answers each number of updates that it is asked for when they have come."""
    from websockets.exceptions import ConnectionClosed

    os.nice(_NICENESS)
    with _page(port) as page:
        page.send(_first_look())
        pipe.send(None)
        updates = data = 0
        wanted: float = math.inf
        while True:
            if wanted == math.inf and pipe.poll():
                wanted = pipe.recv()
            if updates >= wanted:
                pipe.send(Sent(updates, data))
                wanted = math.inf
            try:
                length = len(page.recv(timeout=POLL_S))
            except TimeoutError:
                continue
            except ConnectionClosed:
                break
            data += length
            updates += length in counted
    while True:
        if wanted == math.inf:
            pipe.recv()
        pipe.send(Sent(updates, data))
        wanted = math.inf


def _first_look() -> bytes:
    """Where the visitor looks from: viser counts nobody as there who has not said so."""
    import msgspec

    look = {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (2.0, -2.0, 2.0),
        "fov": 0.9,
        "near": 0.01,
        "far": 100.0,
        "image_height": 800,
        "image_width": 1280,
        "look_at": (0.0, 0.0, 0.0),
        "up_direction": (0.0, 0.0, 1.0),
    }
    return msgspec.msgpack.encode(look)


def _page(port: int) -> Any:
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            return connect_to(port)
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)
