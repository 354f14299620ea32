"""An OAK device without hardware: depthai host nodes that send what a camera would, through depthai's own queues."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from datetime import timedelta
from itertools import count
from typing import Any

import depthai as dai
import numpy as np

from twin_node.rig.cameras.oak import OakCamera
from twin_node.rig.cameras.oak_lens import FactoryCalibration

PERIOD_S = 0.05
DEPTH_MM = 1500


class Frames(dai.node.ThreadedHostNode):
    """Sends images until it is stopped, or `unplugged` is set."""

    def __init__(self) -> None:
        dai.node.ThreadedHostNode.__init__(self)
        self.out = self.createOutput()
        self.unplugged = threading.Event()
        self.camera = OakCamera("none")
        self.is_depth = False

    def run(self) -> None:
        number = 0
        while self.isRunning() and not self.unplugged.wait(PERIOD_S):
            at = round(dai.Clock.now().total_seconds() / PERIOD_S) * PERIOD_S
            self.out.send(image_frame(self.camera, self.is_depth, at, number))
            number += 1


class HostStreams:
    """A device's queues, fed by host nodes."""

    def __init__(self, camera: OakCamera, calibration: FactoryCalibration | None = None) -> None:
        self.calibration = calibration
        self._pipeline = dai.Pipeline(False)
        self._nodes: list[Any] = []
        self.colour = self._source(camera, False)
        self.depth = self._source(camera, True) if camera.depth else None
        self._pipeline.start()

    def _source(self, camera: OakCamera, is_depth: bool) -> Any:
        node = self._pipeline.create(Frames)
        node.camera, node.is_depth = camera, is_depth
        self._nodes.append(node)
        return node.out.createOutputQueue(maxSize=4, blocking=False)

    def unplug(self) -> None:
        """As when the cable is pulled: the queues close."""
        for node in self._nodes:
            node.unplugged.set()
        self.colour.close()

    def close(self) -> None:
        """Ends the pipeline."""
        for node in self._nodes:
            node.unplugged.set()
        self._pipeline.stop()
        self._pipeline.wait()  # or its end waits for nodes that wait for Python's lock, which it holds


class LateDepthStreams:
    """A device whose depth images always come after their colour image, one at a time."""

    calibration = None

    def __init__(self, camera: OakCamera, first_depth: int, lost_colour: int | None) -> None:
        """`first_depth`: exposure of its first depth image, 0: that of the first colour image; one of these is lost."""
        self.colour = _Awaited(camera, False, (i for i in count() if i != lost_colour))
        self.depth = _Awaited(camera, True, count(first_depth))

    def close(self) -> None:
        """Nothing runs that would have to end."""


class _Awaited:
    """A queue of depthai's in which nothing waits, and whoever waits gets the next image."""

    def __init__(self, camera: OakCamera, is_depth: bool, exposures: Iterator[int]) -> None:
        self._camera, self._is_depth, self._exposures = camera, is_depth, exposures

    def get(self, timeout: timedelta) -> dai.ImgFrame:
        number = next(self._exposures)
        return image_frame(self._camera, self._is_depth, 1.0 + number * PERIOD_S, 1 + number)

    def tryGetAll(self) -> list[dai.ImgFrame]:
        return []


def image_frame(camera: OakCamera, is_depth: bool, at_s: float, number: int) -> dai.ImgFrame:
    """An image as depthai sends it, captured at `at_s` on its clock."""
    frame, shape = dai.ImgFrame(), (camera.height, camera.width)
    if is_depth:
        frame.setType(dai.ImgFrame.Type.RAW16)
        frame.setData(np.full(shape, DEPTH_MM, np.uint16).view(np.uint8).reshape(-1))
    else:
        frame.setType(dai.ImgFrame.Type.BGR888i)
        frame.setData(_picture(*shape).reshape(-1))
    frame.setWidth(camera.width)
    frame.setHeight(camera.height)
    frame.setTimestamp(timedelta(seconds=at_s))
    frame.setSequenceNum(number)
    return frame


def _picture(height: int, width: int) -> np.ndarray:
    """[H, W, 3] BGR: something to see, the same every time; its first pixel is known."""
    blocks = np.random.default_rng(0).integers(0, 255, (height // 8, width // 8, 3), dtype=np.uint8)
    picture = blocks.repeat(8, axis=0).repeat(8, axis=1)
    picture[0, 0] = (10, 20, 200)
    return picture
