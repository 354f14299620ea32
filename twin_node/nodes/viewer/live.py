"""A running twin on the page: the newest of every topic, drawn in a thread of its own."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

from twin_node.errors import TwinError
from twin_node.messages import Message, convert
from twin_node.nodes.snapshot import Said, Snapshot, newest_joints
from twin_node.nodes.topics import (
    DIAGNOSTICS,
    GAUSSIANS,
    GAUSSIANS_MOVING,
    JOINT_STATES,
    OBSTACLES,
    SEPARATION,
    TRAJECTORY,
    CameraTopics,
)
from twin_node.nodes.ur_driver import DRIVEN_ARM
from twin_node.nodes.viewer.page import DEFAULT_PORT, LOOPBACK, CellPage, ViewerError
from twin_node.nodes.viewer.panel import OF_THE_TWIN
from twin_node.nodes.viewer.picked import HISTORY_NS
from twin_node.nodes.viewer.priority import go_last
from twin_node.ranges import PORTS, WIDTHS_PX, check_ranges
from twin_node.rig import FrameAssembler
from twin_node.runtime.clock import Clock
from twin_node.runtime.executor import Timers
from twin_node.runtime.node import Node
from twin_node.runtime.wire import Cancel, Encoded
from twin_node.runtime.wire_bus import WireBus

FRAME_S = 0.05
"""Shortest time between two pictures, s: what people see as motion, at a cost that the twin does not feel."""
STILL_S = 1.0
"""Longest time between two pictures while somebody watches, s: what is out of force, or silent, is seen to be so."""
DRIVER_SPEAKS_NS = 3_000_000_000
"""What a driver has said is true no longer than this, ns: it speaks once a second."""
LOOK_S = 0.5
"""How often cameras are looked for that are not there yet, s."""
REMEMBERED_NS = {
    **dict.fromkeys((OBSTACLES, GAUSSIANS, GAUSSIANS_MOVING), HISTORY_NS),
    JOINT_STATES: 1_000_000_000,
}
"""Topics of which more than the newest is kept, and for how long: for the history of what is picked, and for the arm's
joints where a gripper's come in between."""


@dataclass(frozen=True)
class Heard:
    """A message as it came; decoded when somebody looks at it."""

    stamp: int
    encoded: Encoded

    @cached_property
    def message(self) -> Message:
        """Raises `MessageError` for damaged data."""
        return self.encoded.decode()


@dataclass(frozen=True)
class ViewerParameters:
    """Where the page is, and what it shows."""

    host: str = LOOPBACK
    port: int = DEFAULT_PORT
    width: int = 160
    """Of the cameras' images, px."""
    rig_file: str = ""
    """Calibration in place of what the graph says of its cameras; not looked at where a launch file has a rig."""

    def __post_init__(self) -> None:
        """Raises `ViewerError` for a port or a width that is none: no page, or no image, could be made with it."""
        check_ranges(self, ViewerError, "viewer: ", port=PORTS, width=WIDTHS_PX)


@dataclass(frozen=True)
class LiveCameras:
    """The cameras of a graph: where their images come, and what makes views of them."""

    topics: tuple[CameraTopics, ...]
    assembler: FrameAssembler | None
    """None: there are none any more."""


class ViewerNode(Node):
    """Keeps the newest message of each topic, and draws at most 20 pictures per second of them while anybody watches.

    The graph's thread only stores references: pictures that come too late are dropped here, never there.
    """

    def __init__(
        self,
        bus: WireBus,
        clock: Clock,
        timers: Timers,
        open_page: Callable[[], CellPage],
        find_cameras: Callable[[], LiveCameras | None],
    ) -> None:
        """`open_page()` is called when the node is configured: a port belongs to one process.

        `find_cameras()`: the graph's cameras where they are others than when it was last called, else None.
        """
        super().__init__("viewer", bus, clock)
        self._wire_bus = bus
        self._timers = timers
        self._open_page = open_page
        self._page: CellPage
        self._find_cameras = find_cameras
        self._cameras: LiveCameras | None = None
        self._images: dict[str, Cancel] = {}
        self._newest: dict[str, Said] = {}
        self._past: dict[str, tuple[Said, ...]] = {}
        self._now = 0
        self._problem: str | None = None
        self._driver: tuple[int, convert.Diagnosis] | None = None
        """What the arm's driver said last, and when, ns."""
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def on_configure(self) -> None:
        """Raises `ViewerError` where viser is not installed or the port is taken."""
        self._page = self._open_page()
        for topic in (*OF_THE_TWIN, SEPARATION, JOINT_STATES, TRAJECTORY):
            self._wire_bus.subscribe_raw(topic, partial(self._keep, topic))
        self._wire_bus.subscribe(DIAGNOSTICS, self._on_diagnostics)
        self._look_for_cameras()
        self._timers.every(LOOK_S, self._look_for_cameras)

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

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """Who watches, or what cannot be shown."""
        if self._thread is not None and not self._thread.is_alive() and not self._stopped.is_set():
            failed = "drawing has failed, see the log of this process; the page stands still"
            return (convert.Diagnosis(f"{self.name}: page", convert.Level.ERROR, failed),)
        if self._problem is not None:
            return (convert.Diagnosis(f"{self.name}: page", convert.Level.WARN, self._problem),)
        readings = (convert.Reading("visitors", str(self._page.visitors)),)
        return (convert.Diagnosis(f"{self.name}: page", convert.Level.OK, self._page.url, readings),)

    def _look_for_cameras(self) -> None:
        found = self._find_cameras()
        if found is None:
            return
        self._cameras = found
        kinds = {camera.image: camera.kinds[camera.image] for camera in found.topics}
        for topic in self._images.keys() - kinds.keys():
            self._images.pop(topic)()
            self._newest.pop(topic, None)
        for topic in kinds.keys() - self._images.keys():
            self._wire_bus.declare(topic, kinds[topic])
            self._images[topic] = self._wire_bus.subscribe_raw(topic, partial(self._keep, topic))

    def _on_diagnostics(self, message: Message) -> None:
        for found in convert.diagnostics_from_message(message):
            if found.name == DRIVEN_ARM:
                self._driver = self.clock.now(), found

    def _standing(self, now: int) -> str | None:
        """Why the arm's driver lets it stand, whatever is decided; None where it does not."""
        if self._driver is None or not 0 <= now - self._driver[0] <= DRIVER_SPEAKS_NS:
            return None
        found = self._driver[1]
        return None if found.level is convert.Level.OK else f"the arm stands, its driver says: {found.message}"

    def _keep(self, topic: str, message: Encoded) -> None:
        now = self.clock.now()
        if now < self._now:  # a log has begun again: what was heard is of another time
            self._newest, self._past = {}, {}
        self._now = now
        heard = Heard(now, message)
        self._newest[topic] = heard
        if topic in REMEMBERED_NS:
            past = (said for said in self._past.get(topic, ()) if said.stamp >= now - REMEMBERED_NS[topic])
            self._past[topic] = (*past, heard)

    def _earlier(self, stamp: int, topic: str, ns: int) -> Sequence[Said]:
        return [said for said in self._past.get(topic, ()) if stamp - ns <= said.stamp <= stamp]

    def _joints_with(self, stamp: int, names: frozenset[str]) -> Said:
        said = newest_joints(self._earlier(stamp, JOINT_STATES, REMEMBERED_NS[JOINT_STATES]), names)
        if said is None:
            raise LookupError
        return said

    def _draw(self) -> None:
        go_last()
        drawn: dict[str, Said] = {}
        drawn_at = -math.inf
        cameras: LiveCameras | None = None
        while not self._stopped.wait(FRAME_S):
            if self._cameras is not cameras:
                cameras = self._cameras
                assembler = None if cameras is None else cameras.assembler
                self._page.set_cameras(() if assembler is None else assembler.cameras)
            newest = dict(self._newest)
            if not newest or not self._page.visitors:
                continue
            is_still = newest == drawn and time.monotonic() < drawn_at + STILL_S
            if self._page.take_change() or not is_still:
                drawn, drawn_at = newest, time.monotonic()
                self._show(newest, cameras)

    def _show(self, newest: dict[str, Said], cameras: LiveCameras | None) -> None:
        topics = {} if cameras is None else {camera.name: camera for camera in cameras.topics}
        assembler = None if cameras is None else cameras.assembler
        now = self.clock.now()
        earlier, joints_with = partial(self._earlier, now), partial(self._joints_with, now)
        try:
            self._page.show(Snapshot(now, newest, topics, assembler, earlier, joints_with))
            self._problem = None
        except TwinError as error:  # of one message: the next may be sound, and the page says what was wrong
            self._problem = str(error)
        self._page.tell("; ".join(filter(None, (self._standing(now), self._problem))) or None)
