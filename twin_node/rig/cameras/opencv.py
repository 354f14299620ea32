"""Anything that OpenCV opens: USB cameras, RTSP streams, video files."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from twin_node.ranges import NOT_NEGATIVE, check_ranges
from twin_node.rig.cameras.image_source import CameraImage
from twin_node.rig.cameras.stamps import CaptureStamps
from twin_node.rig.cameras.threaded_source import RETRY_S, ThreadedSource
from twin_node.rig.errors import RigError


@dataclass(frozen=True)
class OpenCvCamera:
    """One camera and how it is opened."""

    name: str
    address: str
    """Path of a USB camera in `/dev/v4l/by-path`, or its number, which may become another's when several are plugged in
    anew; URL of a stream; or path of a video, which is played at its own rate, again and again."""
    width: int = 0
    """Pixels to ask of a USB camera; 0: its default."""
    height: int = 0
    fps: float = 0.0
    """Rate to ask of a USB camera, Hz; 0: its default."""
    latency_ms: float = 0.0
    """From mid-exposure to the image's arrival, as measured (`calibrate time`); stamps are so much before it."""

    def __post_init__(self) -> None:
        """Raises `RigError` where there is no address, and for numbers below 0 or infinite."""
        where, free = f"camera {self.name}: ", NOT_NEGATIVE
        if not self.address:
            raise RigError(f"{where}address: expected a number, a URL or a path, found none")
        check_ranges(self, RigError, where, width=free, height=free, fps=free, latency_ms=free)


class OpenCvSource(ThreadedSource[OpenCvCamera]):
    """A thread per camera; one that fails is opened again every second."""

    def __init__(self, cameras: Sequence[OpenCvCamera], capture: Callable[[int | str], Any] | None = None) -> None:
        """`capture`: opens an address; OpenCV's own. Raises `RigError` for no cameras or equal names."""
        super().__init__(cameras)
        self._capture = capture or _open_capture

    def _read(self, camera: OpenCvCamera, stamps: CaptureStamps, connected: Callable[[], None]) -> str:
        capture = self._open(camera)
        try:
            if capture.isOpened():
                connected()
                self._play(camera, capture, stamps)
        finally:
            capture.release()
        return f"no image from {camera.address}; trying again every {RETRY_S:g} s"

    def _open(self, camera: OpenCvCamera) -> Any:
        capture = self._capture(int(camera.address) if camera.address.isdecimal() else camera.address)
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, camera.width),
            (cv2.CAP_PROP_FRAME_HEIGHT, camera.height),
            (cv2.CAP_PROP_FPS, camera.fps),
        ):
            if value:
                capture.set(key, value)
        return capture

    def _play(self, camera: OpenCvCamera, capture: Any, stamps: CaptureStamps) -> None:
        """Images until there are none; files, which could be read at once, at their own rate and again and again."""
        frames = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        period_s = 1 / max(capture.get(cv2.CAP_PROP_FPS), 1.0) if frames > 0 else 0.0
        due = time.monotonic()
        while not self._queue.closed.is_set():
            ok, bgr = capture.read()
            if not ok and frames > 0 and capture.set(cv2.CAP_PROP_POS_FRAMES, 0):
                ok, bgr = capture.read()
            if not ok:
                return
            stamp = stamps.of_arrival(int(camera.latency_ms * 1e6))
            rgb = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
            self._queue.put(CameraImage(camera.name, stamp, rgb))
            due += period_s
            if self._queue.closed.wait(max(0.0, due - time.monotonic()) if period_s else 0.0):
                return


def _open_capture(address: int | str) -> Any:
    return cv2.VideoCapture(address)
