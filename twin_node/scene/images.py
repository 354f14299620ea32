"""What comes in: cameras, their images, and the arm's joints beside them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import inverse_pose
from twin_node.scene.arrays import Bool, Float32, Float64, UInt8
from twin_node.scene.stamps import count_as_python


@dataclass(frozen=True)
class RigCamera:
    """One camera of a rig as calibrated: the raw, distorted image and where its pixels come from."""

    name: str
    width: int
    """Width in pixels of the image that `K` belongs to."""
    height: int
    K: Float64
    """[3, 3] intrinsics in pixels, OpenCV convention (centre of the top-left pixel at 0, 0)."""
    T_base_cam: Float64
    """[4, 4] maps optical-frame coordinates (x right, y down, z forward) to `base_link`."""
    distortion_model: str = "plumb_bob"
    """ROS name: plumb_bob, rational_polynomial or equidistant."""
    D: Float64 = field(default_factory=lambda: np.zeros(5))
    """Distortion coefficients in the model's own order."""
    sigma_m: float = 0.0
    """Error of the extrinsics seen at the working distance, 1 sigma, metres; 0 where unknown."""
    time_offset_ns: int = 0
    """Added to the camera's stamps to give the rig's clock, at `time_reference_ns`."""
    time_rate_ppm: float = 0.0
    """How fast the offset grows, parts per million of the camera's own time."""
    time_reference_ns: int = 0
    """Stamp of the camera at which the offset is `time_offset_ns`; where the rate is 0 it tells the clock alone."""
    depth_lens: RigCamera | None = None
    """What its depth was seen by, from the same place, where that is another lens than its image's: some drivers align
    depth with the image without its distortion. None: pixels of depth and image are the same."""

    def rig_time(self, stamp: int) -> int:
        """The rig's time, ns, of a stamp of the camera's own clock, ns."""
        grown = self.time_rate_ppm * 1e-6 * (stamp - self.time_reference_ns) if self.time_rate_ppm else 0.0
        return stamp + self.time_offset_ns + round(grown)

    def own_time(self, rig_time: int) -> int:
        """The camera's own stamp, ns, of a time of the rig, ns: undoes `rig_time`."""
        stamp = rig_time - self.time_offset_ns
        rate = self.time_rate_ppm * 1e-6
        return stamp - round(rate / (1 + rate) * (stamp - self.time_reference_ns)) if rate else stamp


@dataclass(frozen=True)
class Rig:
    """A calibrated set of cameras."""

    cameras: tuple[RigCamera, ...]
    workspace: Float64 | None = None
    """[2, 3] lower and upper corner of the volume to model, metres; None: derived from the cameras."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: what an undistorted image, at working resolution, was seen by."""

    name: str
    width: int
    height: int
    K: Float64
    """[3, 3] intrinsics in pixels, gsplat's convention (centre of the top-left pixel at 0.5, 0.5)."""
    T_base_cam: Float64
    """[4, 4] maps optical-frame coordinates to `base_link`."""
    sigma_m: float = 0.0
    """Error of the extrinsics seen at the working distance, 1 sigma, metres."""

    @cached_property
    def viewmat(self) -> Float64:
        """[4, 4] maps `base_link` to the optical frame."""
        return inverse_pose(self.T_base_cam)

    def sees_as(self, other: Camera) -> bool:
        """Whether the same pixels of both see the same, as of one camera that has come by another way."""
        return self is other or (
            (self.name, self.width, self.height) == (other.name, other.width, other.height)
            and np.array_equal(self.K, other.K)
            and np.array_equal(self.T_base_cam, other.T_base_cam)
        )


@dataclass(frozen=True)
class View:
    """One camera's undistorted image at its own time."""

    camera: Camera
    stamp: int
    """Mid-exposure, ns."""
    rgb: UInt8
    """[H, W, 3]."""
    depth: Float32 | None = None
    """[H, W] metres along the optical axis; 0 where unknown (never NaN or negative)."""
    valid: Bool | None = None
    """[H, W] False where undistortion found no pixel; None: all valid."""

    def __post_init__(self) -> None:
        count_as_python(self)

    def misfit(self, **masks: Bool | None) -> str | None:
        """The first of its arrays, or of `masks` [H, W] of it, that is not of its camera's size or not of its kind.

        As a sentence for an error, also for a stamp in seconds; None where all fit. Compiled code takes sizes from the
        camera, and looks no further.
        """
        if not isinstance(self.stamp, int):
            return (
                f"camera {self.camera.name}: expected a stamp in whole nanoseconds, found {self.stamp!r}; of seconds "
                "give round(1e9 * seconds)"
            )
        size = (self.camera.height, self.camera.width)
        images = (("rgb", self.rgb, (*size, 3), np.uint8), ("depth", self.depth, size, np.float32))
        for name, array, shape, kind in (
            *images,
            *((name, mask, size, np.bool_) for name, mask in (("valid", self.valid), *masks.items())),
        ):
            if array is not None and (array.shape != shape or array.dtype != kind):
                return (
                    f"camera {self.camera.name}: expected {name} {list(shape)} of {np.dtype(kind)}, found "
                    f"{list(array.shape)} of {array.dtype}; give images of the camera's size"
                )
        return None


@dataclass(frozen=True)
class JointSample:
    """The arm's joints at one time."""

    stamp: int
    names: tuple[str, ...]
    positions: Float64
    """[J] rad."""
    velocities: Float64
    """[J] rad/s."""

    def __post_init__(self) -> None:
        count_as_python(self)

    def at(self, stamp: int) -> JointSample:
        """The joints moved on, or back, at their velocities to a stamp, ns; as they are where no velocity is told."""
        if not self.velocities.any():
            return self
        positions = self.positions + (stamp - self.stamp) * 1e-9 * self.velocities
        return replace(self, stamp=stamp, positions=positions)


@dataclass(frozen=True)
class JointPath:
    """Where the arm means to be: joint positions over absolute time."""

    names: tuple[str, ...]
    stamps: NDArray[np.int64]
    """[T] ns, strictly increasing."""
    positions: Float64
    """[T, J] rad."""


@dataclass(frozen=True)
class FrameSet:
    """Images that belong together; each keeps its own stamp."""

    stamp: int
    """The newest view's stamp, ns: the time that the evidence reaches up to."""
    views: tuple[View, ...]
    """One per live camera, in the rig's order; a silent camera is missing."""
    joints: JointSample | None = None
    """The arm's joints, where the source has them: at `stamp`, or the nearest known, which keep their own stamp."""
    sequence: int = 0
    """Counts sets from the source, the dropped ones too."""

    def __post_init__(self) -> None:
        count_as_python(self)


class FrameSource(Protocol):
    """Anything that yields synchronised images: logs, cameras, the simulated rig, data sets."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras of the source, in the order of every set's views."""

    def __iter__(self) -> Iterator[FrameSet]:
        """Sets in rising order of stamps."""
