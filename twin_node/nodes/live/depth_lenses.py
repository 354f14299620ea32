"""What the depth of a live graph's cameras was seen by, as the CameraInfo of their drivers tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from twin_node.messages import Message
from twin_node.nodes.calibration import depth_lens_of, other_pinhole
from twin_node.nodes.topics import CameraTopics
from twin_node.runtime.wire import Encoded
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import RigCamera


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
    ) -> None:
        """`see_by(camera, lens)` is called for depth of another lens, `say(line)` where it is not aligned at all."""
        self._bus = bus
        self._cameras = [camera for camera in cameras if camera.depth_info is not None]
        self._see_by = see_by
        self._say = say
        self._heard: dict[str, Message] = {}

    def listen(self) -> None:
        """From the node's configuration on."""
        for camera in self._cameras:
            for topic in (camera.info, camera.depth_info):
                assert topic is not None
                self._bus.subscribe_raw(topic, partial(self._hear, camera, topic))

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
