"""Puts synchronised images together into a `FrameSet` of undistorted views."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin_node.rig.errors import RigError
from twin_node.rig.undistort import Undistorter
from twin_node.scene import Camera, Float32, FrameSet, JointSample, RigCamera, UInt8, View

MOST_JOINT_GAP_NS = 100_000_000
"""Joints further from a set's stamp than this are not its own."""
JOINTS_KEPT_NS = 2_000_000_000
"""Joint samples stamped further than this from the one that came last are dropped: longer than any set waits."""


@dataclass(frozen=True)
class DecodedImage:
    """One camera's raw image as decoded."""

    stamp: int
    """Mid-exposure on the rig's clock (`RigCamera.rig_time` of the camera's stamp), ns."""
    rgb: UInt8
    """[H, W, 3]."""
    depth: Float32 | None = None
    """[h, w] metres along the optical axis, aligned with `rgb`."""


class FrameAssembler:
    """Makes frame sets of a rig's images at the working width, with the arm's joints at or near their time.

    Raises `RigError` for a rig without cameras.
    """

    def __init__(self, cameras: Sequence[RigCamera], width: int | None = None) -> None:
        """`width`: of the views of wider cameras, pixels; None: each camera's own. None is enlarged."""
        if not cameras:
            raise RigError("frame assembler: expected at least one camera, found none")
        most = max(camera.width for camera in cameras) if width is None else width
        self._undistorters = {camera.name: Undistorter(camera, min(camera.width, most)) for camera in cameras}
        self._joints: list[JointSample] = []
        self._sequence = 0

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The pinhole cameras of the views, in the rig's order."""
        return tuple(undistorter.camera for undistorter in self._undistorters.values())

    def see_depth_by(self, name: str, lens: RigCamera) -> None:
        """From now on a camera's depth is taken to be what another lens in its place sees."""
        self._undistorters[name].see_depth_by(lens)

    def add_joints(self, sample: JointSample) -> None:
        """Takes the arm's joints at one time, in any order of stamps; a clock that was put back is followed."""
        insort(self._joints, sample, key=lambda s: s.stamp)
        while self._joints[0].stamp < sample.stamp - JOINTS_KEPT_NS:
            self._joints.pop(0)
        while self._joints[-1].stamp > sample.stamp + JOINTS_KEPT_NS:
            self._joints.pop()

    def assemble(self, images: Mapping[str, DecodedImage]) -> FrameSet:
        """The frame set of the images of one instant, by camera name; a silent camera is left out.

        Raises `RigError` for an unknown camera, no images at all or an image that is not of the calibrated size.
        """
        return self.assemble_views([self.view(name, image) for name, image in images.items()])

    def view(self, name: str, image: DecodedImage) -> View:
        """The undistorted view of one camera's image.

        Raises `RigError` for an unknown camera or an image that is not of the calibrated size.
        """
        if name not in self._undistorters:
            known = ", ".join(self._undistorters)
            raise RigError(
                f"frame assembler: expected images of {known}, found one of {name!r}; is this the right rig file?"
            )
        return self._undistorters[name].view(image.stamp, image.rgb, image.depth)

    def assemble_views(self, views: Sequence[View]) -> FrameSet:
        """The frame set of views of one instant, in the rig's order. Raises `RigError` for none."""
        if not views:
            raise RigError("frame assembler: expected the image of at least one camera, found none")
        seen = {view.camera.name: view for view in views}
        stamp = max(view.stamp for view in views)
        ordered = tuple(seen[name] for name in self._undistorters if name in seen)
        frames = FrameSet(stamp, ordered, self._joints_at(stamp), self._sequence)
        self._sequence += 1
        return frames

    def reset(self) -> None:
        """Forgets the joints and starts counting anew: after a loop or a jump in time."""
        self._joints.clear()
        self._sequence = 0

    def _joints_at(self, stamp: int) -> JointSample | None:
        """Between the samples before and after a stamp, ns, or the only one: it keeps its time, by which it is old."""
        place = bisect_left(self._joints, stamp, key=lambda s: s.stamp)
        around = [s for s in self._joints[max(place - 1, 0) : place + 1] if abs(s.stamp - stamp) <= MOST_JOINT_GAP_NS]
        match around:
            case [before, after]:
                return _between(before, after, stamp)
            case [only]:
                return only
            case _:
                return None


def _between(before: JointSample, after: JointSample, stamp: int) -> JointSample:
    """The joints at a stamp, ns, after that of one sample and up to that of the next.

    The nearer sample, where the two tell of other joints, or one has turned by half a turn meanwhile: some drivers
    count joints without limits within one turn.
    """
    if before.names != after.names or np.abs(after.positions - before.positions).max(initial=0.0) > math.pi:
        return before if 2 * stamp < before.stamp + after.stamp else after
    share = (stamp - before.stamp) / (after.stamp - before.stamp)
    positions, velocities = (
        (1 - share) * a + share * b
        for a, b in ((before.positions, after.positions), (before.velocities, after.velocities))
    )
    return JointSample(stamp, before.names, positions, velocities)
