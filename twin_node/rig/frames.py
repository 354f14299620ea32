"""Puts synchronised images together into a `FrameSet` of undistorted views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from twin_node.rig.errors import RigError
from twin_node.rig.told_joints import ToldJoints
from twin_node.rig.undistort import Undistorter
from twin_node.scene import Camera, Float32, FrameSet, JointSample, RigCamera, UInt8, View


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
        self._joints = ToldJoints()
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
        self._joints.add(sample)

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
        frames = FrameSet(stamp, ordered, self._joints.near(stamp), self._sequence)
        self._sequence += 1
        return frames

    def reset(self) -> None:
        """Forgets the joints and starts counting anew: after a loop or a jump in time."""
        self._joints = ToldJoints()
        self._sequence = 0
