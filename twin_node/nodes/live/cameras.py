"""Real cameras as a node: their images with calibration, and how each is doing."""

from __future__ import annotations

from dataclasses import dataclass, field

from twin_node.errors import several
from twin_node.messages import convert
from twin_node.nodes.live.own_thread import OwnThread
from twin_node.nodes.live.rig_messages import depth_message, publish_calibration, publish_image
from twin_node.nodes.live.rig_source import RigParameters, read_rig, topics_of
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import GraphError
from twin_node.rig.cameras import CameraImage, ImageSource, OpenCvCamera, OpenCvSource
from twin_node.rig.cameras.oak import OakCamera, OakSource
from twin_node.rig.cameras.oak_lens import FactoryCalibration
from twin_node.runtime.node import Node
from twin_node.scene import RigCamera

FOCAL_TOLERANCE = 0.02
"""A rig file whose focal length differs so much from the device's own is named: another lens, mode or device."""
NO_TIME = "this computer has no time for so many; let the cameras take fewer or smaller ones, or run them elsewhere"
"""What is told of images that newer ones have replaced on their way."""


@dataclass(frozen=True)
class CamerasParameters:
    """Which cameras, by their names in the rig file; those of one kind run in one node."""

    oak: tuple[OakCamera, ...] = ()
    opencv: tuple[OpenCvCamera, ...] = ()
    rig: RigParameters = field(default_factory=RigParameters)


def make_cameras(setup: Setup) -> Node:
    """The cameras that the parameters list."""
    parameters = setup.parameters(CamerasParameters)
    if bool(parameters.oak) == bool(parameters.opencv):
        raise GraphError(f"{setup.where}: {setup.name}: expected cameras under 'oak' or under 'opencv'")
    source: ImageSource = OakSource(parameters.oak) if parameters.oak else OpenCvSource(parameters.opencv)
    return CamerasNode(setup, source, parameters.rig, _unsure(parameters.opencv))


class CamerasNode(Node):
    """Publishes what an image source gives, each image with its CameraInfo.

    Raises `GraphError` for a camera that the rig file does not know.
    """

    def __init__(self, setup: Setup, source: ImageSource, rig: RigParameters, doubt: str | None = None) -> None:
        """`doubt`: what is told to the user of how the cameras are named."""
        super().__init__(setup.name, setup.bus, setup.clock)
        self._say, self._told = setup.say, doubt
        self._source = source
        self._rig_parameters = rig
        self._rig = read_rig(rig).rig
        self._cameras = {camera.name: camera for camera in self._rig.cameras}
        unknown = [name for name in source.cameras if name not in self._cameras]
        if unknown:
            raise GraphError(
                f"{setup.where}: {setup.name}: camera '{unknown[0]}' is not in the rig file, which has "
                f"{', '.join(self._cameras)}; name it as there, or calibrate it"
            )
        self._lost = dict.fromkeys(source.cameras, 0)
        """Of every camera, how many images had been lost by the last report."""
        self._thread = OwnThread("cameras", self._publish_all, setup.finish)

    def on_configure(self) -> None:
        if self._told is not None:
            self._say(self._told)

    def on_activate(self) -> None:
        publish_calibration(self.bus, self._rig, self._rig_parameters, self.clock.now())
        self._thread.start()

    def on_deactivate(self) -> None:
        self._source.close()
        self._thread.join()

    def on_cleanup(self) -> None:
        """Raises what ended the images."""
        self._thread.check()

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """How every camera is doing."""
        found = []
        calibrations = self._source.calibrations if isinstance(self._source, OakSource) else {}
        for health in self._source.health:
            level = convert.Level.OK if health.is_connected else convert.Level.ERROR
            message = health.message
            doubt = _doubt(self._cameras[health.camera], calibrations.get(health.camera))
            if health.is_connected and doubt is not None:
                level, message = convert.Level.WARN, doubt
            lost, self._lost[health.camera] = health.lost - self._lost[health.camera], health.lost
            if health.is_connected and lost > 0:
                level, message = convert.Level.WARN, f"{several(lost, 'image')} lost since the last report: {NO_TIME}"
            readings = tuple(convert.Reading(name, str(getattr(health, name))) for name in ("reconnections", "lost"))
            found.append(convert.Diagnosis(f"{self.name}: {health.camera}", level, message, readings, health.camera))
        return tuple(found)

    def _publish_all(self) -> None:
        for image in self._source.images():
            self._publish(image)

    def _publish(self, image: CameraImage) -> None:
        topics = topics_of(image.camera, self._rig_parameters)
        depth = None
        if topics.depth is not None and image.depth is not None:
            depth = depth_message(topics, image.stamp, image.depth)
        publish_image(self.bus, topics, self._cameras[image.camera], image.stamp, image.rgb, depth)


def _unsure(cameras: tuple[OpenCvCamera, ...]) -> str | None:
    """What speaks against telling several USB cameras by their numbers; None where that is not done."""
    numbered = [camera for camera in cameras if camera.address.isdecimal()]
    if len(numbered) < 2:
        return None
    named = ", ".join(f"'{camera.name}' at {camera.address}" for camera in numbered)
    return (
        f"cameras {named}: numbers of USB cameras may change places when they are plugged in or the computer starts, "
        "and the twin would take one camera's images for another's; give paths as 'address', see ls /dev/v4l/by-path"
    )


def _doubt(camera: RigCamera, factory: FactoryCalibration | None) -> str | None:
    """What speaks against the rig file's lens; None where nothing does, or the device does not say."""
    if factory is None:
        return None
    ratio = camera.K[0, 0] / factory.K[0, 0]
    if abs(ratio - 1) <= FOCAL_TOLERANCE:
        return None
    return (
        f"the rig file's focal length is {camera.K[0, 0]:.1f} px, the device's own {factory.K[0, 0]:.1f} px; is this "
        "the right camera, and the mode that it was calibrated in?"
    )
