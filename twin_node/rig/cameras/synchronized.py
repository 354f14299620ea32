"""Running cameras as a source of synchronised sets."""

from __future__ import annotations

from collections.abc import Iterator

from twin_node.rig.cameras.image_source import CameraImage, ImageSource
from twin_node.rig.errors import RigError
from twin_node.rig.frames import DecodedImage, FrameAssembler
from twin_node.rig.synchronizer import ApproximateTimeSynchronizer, SyncParameters, SyncReport, SyncSet
from twin_node.runtime.clock import SystemClock
from twin_node.scene import Camera, FrameSet, Rig


class SynchronizedSource:
    """Sets of undistorted images of running cameras; a `scene.FrameSource` for scripts without a graph.

    A camera that falls silent costs its deadline only when another one sends: sets come as images do. Where this host's
    clock is put back, grouping and its counts begin anew: all that comes would be late for as long as that.
    """

    def __init__(
        self, source: ImageSource, rig: Rig, width: int | None = None, parameters: SyncParameters | None = None
    ) -> None:
        """`width`: of all views, pixels; None: the cameras' own. Raises `RigError` for a rig of other cameras."""
        names = [camera.name for camera in rig.cameras]
        if set(names) != set(source.cameras):
            raise RigError(
                f"cameras: expected those of the rig file ({', '.join(names)}), found {', '.join(source.cameras)}; "
                "name them alike"
            )
        self._source = source
        self._assembler = FrameAssembler(rig.cameras, width)
        self._synchronizer: ApproximateTimeSynchronizer[CameraImage] = ApproximateTimeSynchronizer(names, parameters)

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras, in the rig's order."""
        return self._assembler.cameras

    @property
    def report(self) -> SyncReport:
        """What became of the images."""
        return self._synchronizer.report

    def __iter__(self) -> Iterator[FrameSet]:
        """Sets in rising order of stamps, until the cameras are closed or this host's clock is put back."""
        clock = SystemClock(self._begin_anew)
        for image in self._source.images():
            for ready in self._synchronizer.add(image.camera, image.stamp, image, clock.now()):
                yield self._assembler.assemble(_decoded(ready))

    def _begin_anew(self) -> None:
        self._synchronizer.reset()
        self._assembler.reset()


def _decoded(ready: SyncSet[CameraImage]) -> dict[str, DecodedImage]:
    images = [member.payload for member in ready.members if member is not None]
    return {image.camera: DecodedImage(image.stamp, image.rgb, image.depth) for image in images}
