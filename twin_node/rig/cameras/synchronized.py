"""Running cameras as a source of synchronised sets."""

from __future__ import annotations

import threading
from collections.abc import Iterator

from twin_node.rig.cameras.image_source import CameraImage, ImageSource
from twin_node.rig.clock_kinds import without_other_clocks
from twin_node.rig.errors import RigError
from twin_node.rig.frames import DecodedImage, FrameAssembler
from twin_node.rig.rig_checks import check_rig
from twin_node.rig.synchronizer import ApproximateTimeSynchronizer, SyncParameters, SyncReport, SyncSet
from twin_node.runtime.clock import SystemClock
from twin_node.scene import Camera, FrameSet, JointSample, Rig


class SynchronizedSource:
    """Sets of undistorted images of running cameras; a `scene.FrameSource` for scripts without a graph.

    A camera that falls silent costs its deadline only when another one sends: sets come as images do. Stamps are on the
    rig's clock, where its file has one for stamps since 1970. Where this host's clock is put back, grouping and its
    counts begin anew: all that comes would be late for as long as that.
    """

    def __init__(
        self, source: ImageSource, rig: Rig, width: int | None = None, parameters: SyncParameters | None = None
    ) -> None:
        """`width`: of all views, pixels; None: the cameras' own.

        Raises `RigError` for a rig of other cameras, or one that no rig file may hold.
        """
        names = [camera.name for camera in rig.cameras]
        if set(names) != set(source.cameras):
            raise RigError(
                f"cameras: expected those of the rig file ({', '.join(names)}), found {', '.join(source.cameras)}; "
                "name them alike"
            )
        check_rig(rig)
        self._source = source
        timed = without_other_clocks(rig, since_1970=True)
        self._rig_cameras = {camera.name: camera for camera in timed.cameras}
        self._assembler = FrameAssembler(rig.cameras, width)
        self._joints_told = threading.Lock()
        self._synchronizer: ApproximateTimeSynchronizer[CameraImage] = ApproximateTimeSynchronizer(names, parameters)

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras, in the rig's order."""
        return self._assembler.cameras

    @property
    def report(self) -> SyncReport:
        """What became of the images."""
        return self._synchronizer.report

    def add_joints(self, sample: JointSample) -> None:
        """Takes the arm's joints at one time of the rig's clock, from any thread; sets have those of their own time."""
        with self._joints_told:
            self._assembler.add_joints(sample)

    def __iter__(self) -> Iterator[FrameSet]:
        """Sets in rising order of stamps, until the cameras are closed or this host's clock is put back.

        Raises `RigError` for an image of a camera that the source did not name, or that is not as calibrated.
        """
        clock = SystemClock(self._begin_anew)
        for image in self._source.images():
            if image.camera not in self._rig_cameras:
                raise RigError(
                    f"cameras: expected images of {', '.join(self._rig_cameras)}, found one of {image.camera!r}; name "
                    "them alike"
                )
            stamp = self._rig_cameras[image.camera].rig_time(image.stamp)
            for ready in self._synchronizer.add(image.camera, stamp, image, clock.now()):
                views = [self._assembler.view(name, one) for name, one in _decoded(ready).items()]
                with self._joints_told:
                    frames = self._assembler.assemble_views(views)
                yield frames

    def _begin_anew(self) -> None:
        self._synchronizer.reset()
        with self._joints_told:
            self._assembler.reset()


def _decoded(ready: SyncSet[CameraImage]) -> dict[str, DecodedImage]:
    members = [member for member in ready.members if member is not None]
    return {one.payload.camera: DecodedImage(one.stamp, one.payload.rgb, one.payload.depth) for one in members}
