"""What every kind of camera gives: images one by one, and how it is doing."""

from __future__ import annotations

import queue
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from twin_node.scene import Float32, UInt8, count_as_python

WAIT_S = 0.2
"""How long a source that has no image may take to notice that it is closed, s."""


@dataclass(frozen=True)
class CameraImage:
    """One raw image."""

    camera: str
    stamp: int
    """Mid-exposure, ns since 1970 on this host's clock; rises with every image of a camera."""
    rgb: UInt8
    """[H, W, 3]."""
    depth: Float32 | None = None
    """[H, W] m along the optical axis, aligned with `rgb`, 0 where unknown; None: the camera measures none."""

    def __post_init__(self) -> None:
        count_as_python(self)


@dataclass(frozen=True)
class CameraHealth:
    """How one camera is doing."""

    camera: str
    is_connected: bool
    message: str
    reconnections: int = 0
    """Times that it was lost and has come back."""
    lost: int = 0
    """Images that newer ones have replaced, of whatever camera, before the reader had time for them."""


class ImageSource(Protocol):
    """One or several running cameras."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras."""

    @property
    def health(self) -> tuple[CameraHealth, ...]:
        """How every camera is doing, in the order of `cameras`."""

    def images(self) -> Iterator[CameraImage]:
        """Images as they come, until the source is closed; a camera that is lost is waited for while others go on."""

    def close(self) -> None:
        """Ends `images` and lets go of the cameras."""


class ImageQueue:
    """Images of several cameras' threads on their way to one reader; of those that wait too long the oldest is lost."""

    def __init__(self, size: int) -> None:
        """`size`: images kept while the reader is busy."""
        self._waiting: queue.Queue[CameraImage] = queue.Queue(size)
        self.closed = threading.Event()
        self._lost: Counter[str] = Counter()
        self._counting = threading.Lock()

    def lost(self, camera: str) -> int:
        """Images of a camera that the reader had no time for; from any thread."""
        return self._lost[camera]

    def put(self, image: CameraImage) -> None:
        """Takes an image, from any thread."""
        while True:
            with suppress(queue.Full):
                self._waiting.put_nowait(image)
                return
            with suppress(queue.Empty):
                oldest = self._waiting.get_nowait()
                with self._counting:
                    self._lost[oldest.camera] += 1

    def __iter__(self) -> Iterator[CameraImage]:
        """Images until `closed` is set."""
        while not self.closed.is_set():
            try:
                yield self._waiting.get(timeout=WAIT_S)
            except queue.Empty:
                continue
