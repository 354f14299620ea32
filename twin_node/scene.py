"""What flows between the rooms: frozen records over numpy arrays, in `base_link`, SI units, stamps in int ns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import inverse_pose

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]
UInt8 = NDArray[np.uint8]
UInt32 = NDArray[np.uint32]

HORIZONS_NS = (0, 50_000_000, 100_000_000, 150_000_000, 200_000_000)
"""The forecast's horizons after evidence stamp + latency, ns."""


class Tier(IntEnum):
    """The simplest motion model that explains a Gaussian."""

    STATIC = 0
    ROBOT = 1
    RIGID = 2
    DEFORMABLE = 3
    TRANSIENT = 4


class ObstacleKind(IntEnum):
    """What an obstacle stands for; values as in `twin_msgs/Obstacle`."""

    MOVING = 0
    STATIC = 1
    """Stands still, or is unseen space in which something may lie that does not come out."""
    UNKNOWN = 2
    """Unseen space that something may come out of at any time."""


class ObstacleShape(IntEnum):
    """Shape of an obstacle; values as in `twin_msgs/Obstacle`."""

    SPHERE = 0
    BOX = 1


class MotionExpert(IntEnum):
    """What forecasts motion; values as in `twin_msgs/Obstacle`."""

    PERSISTENCE = 0
    CONSTANT_VELOCITY = 1
    DAMPED = 2
    CONSTANT_ACCELERATION = 3
    AUTOREGRESSION = 4
    FREE_FALL = 5
    NO_EXPERT = 255


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
    """Stamp of the camera at which the offset is `time_offset_ns`; of no matter where the rate is 0."""

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


@dataclass(frozen=True)
class View:
    """One camera's undistorted image at its own time."""

    camera: Camera
    stamp: int
    """Mid-exposure, ns."""
    rgb: UInt8
    """[H, W, 3]."""
    depth: Float32 | None = None
    """[H, W] metres along the optical axis; 0 where unknown (never NaN)."""
    valid: Bool | None = None
    """[H, W] False where undistortion found no pixel; None: all valid."""


@dataclass(frozen=True)
class JointSample:
    """The arm's joints at one time."""

    stamp: int
    names: tuple[str, ...]
    positions: Float64
    """[J] rad."""
    velocities: Float64
    """[J] rad/s."""


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
    """The arm's joints nearest to `stamp`, where the source has them."""
    sequence: int = 0
    """Counts sets from the source, the dropped ones too."""


class FrameSource(Protocol):
    """Anything that yields synchronised images: logs, cameras, the simulated rig, data sets."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras of the source, in the order of every set's views."""

    def __iter__(self) -> Iterator[FrameSet]:
        """Sets in rising order of stamps."""


@dataclass(frozen=True)
class GaussianCloud:
    """Gaussians as they are at one time, in `base_link`."""

    means: Float32
    """[N, 3] m."""
    quats: Float32
    """[N, 4] w, x, y, z."""
    scales: Float32
    """[N, 3] m, linear."""
    opacities: Float32
    """[N] 0 to 1, linear."""
    rgb: Float32
    """[N, 3] 0 to 1."""
    velocities: Float32
    """[N, 3] m/s; zero for STATIC."""
    tiers: UInt8
    """[N] values of `Tier`."""
    ids: UInt32
    """[N] stable for as long as a Gaussian lives."""
    nodes: NDArray[np.int32]
    """[N] row in `NodeStates` of the node that carries it, -1 for none."""

    def only(self, chosen: Bool | NDArray[np.integer]) -> GaussianCloud:
        """The chosen Gaussians: a mask [N], or rows in the order wanted."""
        return GaussianCloud(**{name: values[chosen] for name, values in vars(self).items()})

    def joined(self, other: GaussianCloud) -> GaussianCloud:
        """These Gaussians and then the other's, whose `nodes` must be rows of the same `NodeStates`."""
        return GaussianCloud(**{name: np.concatenate([own, vars(other)[name]]) for name, own in vars(self).items()})


@dataclass(frozen=True)
class NodeStates:
    """Motion nodes: the frames that moving Gaussians live in."""

    ids: UInt32
    """[M] stable for as long as a node lives."""
    positions: Float64
    """[M, 3] m, the centroid of the Gaussians it carries."""
    quats: Float64
    """[M, 4] w, x, y, z, rotation since birth."""
    velocities: Float64
    """[M, 3] m/s."""
    angular_velocities: Float64
    """[M, 3] rad/s, in `base_link`."""
    sigmas: Float64
    """[M] 1 sigma of the position, m."""
    radii: Float64
    """[M] radius of the sphere about `positions` that holds the means of the Gaussians it carries, m."""


@dataclass(frozen=True)
class Exposure:
    """How a camera is exposed beside the light of the model's first set."""

    gains: Float32
    """[3] per colour, what a colour is multiplied by."""
    offsets: Float32
    """[3] what is added then, of colours from 0 to 1."""

    @property
    def is_plain(self) -> bool:
        """Whether the camera shows colours as the model has them."""
        return bool((self.gains == 1).all() and (self.offsets == 0).all())

    @property
    def brightness(self) -> float:
        """The middle of the gains: 1 as bright as the model, 0.5 half as bright."""
        return float(np.median(self.gains))

    def of(self, rgb: Float32) -> Float32:
        """[..., 3] what the camera shows of colours [..., 3] of the model, 0 to 1."""
        shown: Float32 = np.clip(rgb * self.gains + self.offsets, 0, 1)
        return shown


PLAIN = Exposure(np.ones(3, np.float32), np.zeros(3, np.float32))
"""The exposure of the model's first set."""


@dataclass(frozen=True)
class TwinState:
    """The model at the stamp of its evidence."""

    stamp: int
    """Evidence, ns."""
    frames: FrameSet
    """The images that it was brought up to date with, levelled to the light of the first set: see `exposures`."""
    gaussians: GaussianCloud
    nodes: NodeStates
    moving_masks: tuple[Bool, ...]
    """Per view of `frames`: [H, W] True where the image shows something that moves or has moved (robot left out)."""
    robot_masks: tuple[Bool | None, ...]
    """Per view: [H, W] True on the arm and its margin; None where the arm's joints are unknown."""
    warnings: tuple[str, ...] = ()
    exposures: tuple[Exposure, ...] = ()
    """Per view how its camera was exposed; empty: all as the model is."""

    def exposure_of(self, camera: str) -> Exposure:
        """How a camera was exposed; `PLAIN` where that is not known."""
        known = zip(self.frames.views, self.exposures, strict=False)
        return next((exposure for view, exposure in known if view.camera.name == camera), PLAIN)


@dataclass(frozen=True)
class Grid:
    """Axis-aligned voxels in `base_link`; voxel (i, j, k) has flat index (i * ny + j) * nz + k."""

    origin: Float64
    """[3] lower corner (not centre) of voxel (0, 0, 0), m."""
    voxel_size: float
    dims: tuple[int, int, int]

    @property
    def size(self) -> int:
        """Number of voxels."""
        return self.dims[0] * self.dims[1] * self.dims[2]

    def centers(self, indices: NDArray[np.integer]) -> Float64:
        """Voxel centres [n, 3] in metres of flat indices [n]."""
        ijk = np.stack(np.unravel_index(np.asarray(indices, dtype=np.int64), self.dims), axis=-1)
        return self.origin + (ijk + 0.5) * self.voxel_size

    def indices(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        """Flat indices [n] of the voxels that hold points [n, 3]; -1 outside the grid."""
        i, j, k = np.floor((points - self.origin) / self.voxel_size).T.astype(np.int64, order="C")
        nx, ny, nz = self.dims
        inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny) & (k >= 0) & (k < nz)
        flat = (i * ny + j) * nz + k
        return np.where(inside, flat, -1)


@dataclass(frozen=True)
class OccupancyLayer:
    """What moves at one horizon."""

    horizon_ns: int
    indices: UInt32
    """[n] flat voxel indices, strictly increasing."""
    probability: UInt8
    """[n] 255 is certain."""


@dataclass(frozen=True)
class Occupancy:
    """Occupied, free and unknown space now and up to 200 ms ahead. A voxel that is in no list is free."""

    stamp: int
    """Evidence, ns."""
    publish_stamp: int
    """When it was published, on the same clock, ns; layer h is valid at this time + h."""
    grid: Grid
    layers: tuple[OccupancyLayer, ...]
    """Moving space per horizon, `HORIZONS_NS` in order."""
    static: OccupancyLayer
    """Space that stands still, at every horizon."""
    unknown_runs: UInt32
    """[r, 2] start and length of runs of flat indices that no camera sees; disjoint, increasing."""


@dataclass(frozen=True)
class Obstacles:
    """Convex shapes that together hold every occupied voxel over its whole interval."""

    stamp: int
    """Evidence, ns."""
    ids: UInt32
    """[n] stable under small motion."""
    kinds: UInt8
    """[n] values of `ObstacleKind`."""
    shapes: UInt8
    """[n] values of `ObstacleShape`."""
    positions: Float64
    """[n, 3] centres, m."""
    quats: Float64
    """[n, 4] w, x, y, z."""
    sizes: Float64
    """[n, 3] full extents of a box; diameter three times for a sphere, m."""
    velocities: Float64
    """[n, 3] m/s."""
    bounds: Float64
    """[n] calibrated error already inside the shape, m."""
    valid_from: NDArray[np.int64]
    """[n] ns."""
    valid_to: NDArray[np.int64]
    """[n] ns."""
    experts: UInt8 | None = None
    """[n] values of `MotionExpert`: which had the most weight in the forecast; None where nobody says."""


@dataclass(frozen=True)
class Separation:
    """The arm's distance from the obstacles, what the law requires, and the speed it leaves."""

    stamp: int
    """When it was decided, ns."""
    evidence_stamp: int
    """Stamp of the obstacles' evidence, ns."""
    distance: float
    """Smallest distance along the arm's next 200 ms, m; infinite without obstacles."""
    required: float
    """Protective distance at full speed of the closest pair (sum of the terms), m."""
    term_human: float
    term_reaction: float
    term_stopping: float
    term_intrusion: float
    term_uncertainty: float
    link: str
    obstacle_id: int
    """-1 without obstacles."""
    speed_fraction: float
    """0 to 1."""
    reason: str
