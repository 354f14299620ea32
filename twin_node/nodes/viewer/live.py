"""A running twin on the page: the newest of every topic, drawn in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from twin_node.messages import Message
from twin_node.nodes.playback import Said, Snapshot
from twin_node.nodes.topics import JOINT_STATES, RECORDED, TRAJECTORY, CameraTopics
from twin_node.nodes.viewer.page import CellPage
from twin_node.rig import FrameAssembler
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.node import Node

FRAME_S = 0.05
"""Shortest time between two pictures, s: what people see as motion, at a cost that the twin does not feel."""


@dataclass(frozen=True)
class Heard:
    """A message as it came over the bus."""

    stamp: int
    message: Message


@dataclass(frozen=True)
class ViewerParameters:
    """Where the page is."""

    host: str = "127.0.0.1"
    port: int = 8080
    width: int = 160
    """Of the cameras' images, px."""


class ViewerNode(Node):
    """Keeps the newest message of each topic, and draws at most 20 pictures per second of them while anybody watches.

    The graph's thread only stores references: pictures that come too late are dropped here, never there.
    """

    def __init__(
        self, bus: Bus, clock: Clock, page: CellPage, cameras: Sequence[CameraTopics], assembler: FrameAssembler
    ) -> None:
        """`assembler` undistorts the images of `cameras` for the page."""
        super().__init__("viewer", bus, clock)
        self._page = page
        self._newest: dict[str, Said] = {}
        self._assembler = assembler
        self._cameras = {camera.name: camera for camera in cameras}
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def on_configure(self) -> None:
        topics = [*RECORDED, JOINT_STATES, TRAJECTORY, *(camera.image for camera in self._cameras.values())]
        for topic in topics:
            self.bus.subscribe(topic, partial(self._keep, topic))

    def on_activate(self) -> None:
        self._stopped.clear()
        self._thread = threading.Thread(target=self._draw, name="viewer", daemon=True)
        self._thread.start()

    def on_deactivate(self) -> None:
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()

    def on_cleanup(self) -> None:
        self._page.close()

    def _keep(self, topic: str, message: Message) -> None:
        self._newest[topic] = Heard(self.clock.now(), message)

    def _draw(self) -> None:
        drawn: dict[str, Said] = {}
        while not self._stopped.wait(FRAME_S):
            newest = dict(self._newest)
            if newest and self._page.visitors and (newest != drawn or self._page.take_change()):
                self._page.show(Snapshot(self.clock.now(), newest, self._cameras, self._assembler))
                drawn = newest
