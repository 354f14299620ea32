"""Cameras that are read by a thread each, whose images meet in one queue."""

from __future__ import annotations

import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Generic, Protocol, TypeVar

from twin_node.rig.cameras.image_source import CameraHealth, CameraImage, ImageQueue
from twin_node.rig.cameras.stamps import CaptureStamps
from twin_node.rig.errors import RigError

RETRY_S = 1.0
"""Between two attempts to open a camera, or looks for a device, s."""
QUEUED_PER_CAMERA = 4
"""Images of a camera that may wait for the reader: a seventh of a second at 30 Hz."""


class Named(Protocol):
    """Anything with the name of a camera."""

    @property
    def name(self) -> str:
        """As in the rig file."""


C = TypeVar("C", bound=Named)


class ThreadedSource(ABC, Generic[C]):
    """An `ImageSource` of several cameras; a subclass says what the thread of one does."""

    def __init__(self, cameras: Sequence[C]) -> None:
        """Raises `RigError` for no cameras or equal names."""
        names = [camera.name for camera in cameras]
        if not names or len(set(names)) != len(names):
            raise RigError(f"cameras: expected one or more with distinct names, found {', '.join(names) or 'none'}")
        self._cameras = tuple(cameras)
        self._queue = ImageQueue(QUEUED_PER_CAMERA * len(cameras))
        self._health = {name: CameraHealth(name, is_connected=False, message="not looked for yet") for name in names}
        self._threads: list[threading.Thread] = []

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(camera.name for camera in self._cameras)

    @property
    def health(self) -> tuple[CameraHealth, ...]:
        """How every camera is doing."""
        return tuple(replace(self._health[name], lost=self._queue.lost(name)) for name in self.cameras)

    def images(self) -> Iterator[CameraImage]:
        """Images as they come, until the source is closed; asked again, it goes on with the same cameras."""
        for camera in self._cameras[len(self._threads) :]:
            thread = threading.Thread(target=self._serve, args=(camera,), name=camera.name, daemon=True)
            self._threads.append(thread)
            thread.start()
        yield from self._queue

    def close(self) -> None:
        """Ends `images` and lets go of the cameras."""
        self._queue.closed.set()
        for thread in self._threads:
            thread.join()

    def _serve(self, camera: C) -> None:
        """Opens a camera again and again until the source is closed."""
        stamps, connections, failed = self._stamps(), 0, ""

        def connected() -> None:
            nonlocal connections
            connections += 1
            self._health[camera.name] = CameraHealth(camera.name, True, "connected", connections - 1)

        while not self._queue.closed.is_set():
            try:
                message = self._read(camera, stamps, connected)
            except Exception as error:  # whatever a camera's library raises: it may be well the next time
                message = f"its thread failed: {error!r}; trying again every {RETRY_S:g} s"
                if message != failed:  # once into the log: the same again is no news
                    traceback.print_exc()
                failed = message
            self._health[camera.name] = CameraHealth(camera.name, False, message, max(connections - 1, 0))
            self._queue.closed.wait(RETRY_S)

    def _stamps(self) -> CaptureStamps:
        """What turns a camera's times into stamps."""
        return CaptureStamps()

    @abstractmethod
    def _read(self, camera: C, stamps: CaptureStamps, connected: Callable[[], None]) -> str:
        """Opens a camera, calls `connected` once it is, and puts its images into the queue until that is closed.

        Ends where the camera is not there, or is lost; returns why.
        """
