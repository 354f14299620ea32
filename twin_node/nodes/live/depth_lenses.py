"""What the depth of a live graph's cameras was seen by, as the CameraInfo of their drivers tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from twin_node.messages import Message
from twin_node.nodes.calibration import depth_lens_of, other_pinhole
from twin_node.nodes.topics import CameraTopics
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind
from twin_node.runtime.wire import Encoded
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import RigCamera

PATIENCE_NS = 2_000_000_000
"""How long a camera's images are held back at most until what its depth was seen by is told; drivers tell it with every
image, and the first set is what a twin takes to stand."""


class DepthLenses:
    """Hears the CameraInfo of images and depth until both of a camera have come: a rig file has its images' lens alone.

    Both are the driver's: against a lens that was calibrated anew, depth of one lens would seem to be of two.
    """

    def __init__(
        self,
        bus: WireBus,
        cameras: Sequence[CameraTopics],
        see_by: Callable[[str, RigCamera], None],
        say: Callable[[str], None],
        endpoints: Callable[[], Sequence[Endpoint]],
    ) -> None:
        """`see_by(camera, lens)` is called for depth of another lens, `say(line)` where it is not aligned at all.

        `endpoints()`: publishers and subscribers of the graph.
        """
        self._bus = bus
        self._cameras = [camera for camera in cameras if camera.depth_info is not None]
        self._see_by = see_by
        self._say = say
        self._endpoints = endpoints
        self._heard: dict[str, Message] = {}
        self._since: dict[str, int] = {}
        """When each camera was first asked for, ns."""

    def listen(self) -> None:
        """From the node's configuration on."""
        self._endpoints()  # it is told from now on who publishes
        for camera in self._cameras:
            for topic in (camera.info, camera.depth_info):
                assert topic is not None
                self._bus.subscribe_raw(topic, partial(self._hear, camera, topic))

    def is_awaited(self, name: str, now: int) -> bool:
        """Whether a camera's driver is about to tell what its depth was seen by, at a time, ns."""
        camera = next((camera for camera in self._cameras if camera.name == name), None)
        if camera is None or {camera.info, camera.depth_info} <= self._heard.keys():
            return False
        if not 0 <= now - self._since.setdefault(name, now) < PATIENCE_NS:
            return False
        published = {one.topic for one in self._endpoints() if one.kind is EntityKind.PUBLISHER}
        return {self._bus.resolved(topic) for topic in (camera.info, camera.depth_info) if topic} <= published

    def _hear(self, camera: CameraTopics, topic: str, message: Encoded) -> None:
        if topic in self._heard:
            return
        self._heard[topic] = message.decode()
        info, depth_info = self._heard.get(camera.info), self._heard.get(camera.depth_info or "")
        if (why := other_pinhole(camera, info, depth_info)) is not None:
            self._say(
                f"camera '{camera.name}': expected depth aligned with its colour image, found that of another lens on "
                f"{camera.depth} ({why}); let its driver align it (realsense2_camera: align_depth.enable:=true)"
            )
        elif (lens := depth_lens_of(camera, info, depth_info)) is not None:
            self._see_by(camera.name, lens)
