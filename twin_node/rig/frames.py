"""Puts synchronised images together into a `FrameSet` of undistorted views."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_node.rig.errors import RigError
from twin_node.rig.undistort import Undistorter
from twin_node.scene import Camera, Float32, FrameSet, JointSample, RigCamera, UInt8, View

MOST_JOINT_GAP_NS = 100_000_000
"""Joints further from a set's stamp than this are not its own."""
JOINTS_KEPT_NS = 2_000_000_000
"""Joint samples stamped further than this from the one that came last are dropped: longer than any set waits."""
LEAST_JOINT_STEP_NS = 1_000_000
"""Of two joint samples that are closer in time the stamps' jitter would be taken for speed."""


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
        self._tells_velocities = False
        """Whether any joints ever told a velocity other than 0, which many put there who measure none."""
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
        self._tells_velocities |= bool(sample.velocities.any())
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
        self._tells_velocities = False
        self._sequence = 0

    def _joints_at(self, stamp: int) -> JointSample | None:
        """Between the samples before and after a stamp, ns, or the only one: it keeps its time, by which it is old.

        Where no joints ever tell how fast they are, they are as fast as these samples, or the last two, say.
        """
        place = bisect_left(self._joints, stamp, key=lambda s: s.stamp)
        until = self._joints[max(place - 2, 0) : place]
        is_before = bool(until) and stamp - until[-1].stamp <= MOST_JOINT_GAP_NS
        is_after = place < len(self._joints) and self._joints[place].stamp - stamp <= MOST_JOINT_GAP_NS
        if is_before and is_after:
            steps = [until[-1], self._joints[place]]
            found = _between(steps[0], steps[1], stamp)
        elif is_before:
            steps, found = until, until[-1]
        else:
            return self._joints[place] if is_after else None
        return found if self._tells_velocities else _as_fast(found, steps)


def _as_fast(sample: JointSample, steps: Sequence[JointSample]) -> JointSample:
    """A sample without velocities with those from the first of two samples to the second, where these tell."""
    if len(steps) < 2 or not _follow(steps[0], steps[1]):
        return sample
    passed_ns = steps[1].stamp - steps[0].stamp
    if not LEAST_JOINT_STEP_NS <= passed_ns <= 2 * MOST_JOINT_GAP_NS:
        return sample
    return replace(sample, velocities=(steps[1].positions - steps[0].positions) / (passed_ns * 1e-9))


def _between(before: JointSample, after: JointSample, stamp: int) -> JointSample:
    """The joints at a stamp, ns, after that of one sample and up to that of the next; the nearer one where these do not
    follow each other."""
    if not _follow(before, after):
        return before if 2 * stamp < before.stamp + after.stamp else after
    share = (stamp - before.stamp) / (after.stamp - before.stamp)
    positions, velocities = (
        (1 - share) * a + share * b
        for a, b in ((before.positions, after.positions), (before.velocities, after.velocities))
    )
    return JointSample(stamp, before.names, positions, velocities)


def _follow(before: JointSample, after: JointSample) -> bool:
    """Whether two samples are of the same joints, none of which has turned by half a turn meanwhile: some drivers count
    joints without limits within one turn."""
    return before.names == after.names and np.abs(after.positions - before.positions).max(initial=0.0) <= math.pi
