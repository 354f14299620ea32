"""What happens in a simulated cell: a scenario as data."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from twin_node.arm.cycle import CycleParameters
from twin_node.cell.errors import CellError
from twin_node.cell.motion import FARTHEST_M, Path
from twin_node.cell.shapes import Form, Shape
from twin_node.cell.textures import Texture
from twin_node.geometry import pose
from twin_node.ranges import NOT_NEGATIVE, SHARE, Range, check_ranges
from twin_node.robot import UR_NAMES
from twin_node.scene import NAME_WANTED, Float64, is_camera_name

Triple = tuple[float, float, float]

SIZES = {Form.SPHERE: 1, Form.CAPSULE: 2, Form.BOX: 3}
"""Numbers that give a form its size."""

FAULTS = ("nan_depth", "unsorted_stamps", "missing", "frozen", "bumped")
"""Faults a camera can be given."""

UNSORTED_STEP_NS = 50_000_000
"""How early every second image is stamped under the fault `unsorted_stamps`."""

MOST_VOXELS = 100_000_000
"""Of the recorded truth: more are lengths in millimetres, or voxels smaller than anybody looks at."""

SHIRT = Texture(pattern="checker", color=(60, 80, 160), color2=(220, 220, 230), scale_m=0.06)
SKIN = Texture(pattern="speckle", color=(205, 150, 120), color2=(165, 105, 80), scale_m=0.04)
TROUSERS = Texture(pattern="stripes", color=(50, 50, 60), color2=(80, 80, 95), scale_m=0.08)
ARM_PAINT = Texture(pattern="stripes", color=(200, 205, 210), color2=(95, 130, 170), scale_m=0.12)


@dataclass(frozen=True)
class Part:
    """One primitive of a body, in the body's frame."""

    form: str = "box"
    """sphere, capsule or box."""
    size: tuple[float, ...] = (0.1, 0.1, 0.1)
    """m; sphere: radius; capsule: radius, distance of the end centres (along z); box: extents in x, y, z."""
    position: Triple = (0.0, 0.0, 0.0)
    """Centre, m."""
    rpy_deg: Triple = (0.0, 0.0, 0.0)
    texture: Texture = field(default_factory=Texture)

    def __post_init__(self) -> None:
        forms = {form.value: count for form, count in SIZES.items()}
        if self.form not in forms:
            raise CellError(f"part: form must be one of {', '.join(forms)}, found '{self.form}'")
        if len(self.size) != forms[self.form] or min(self.size) <= 0:
            raise CellError(
                f"part: a {self.form} takes {forms[self.form]} positive sizes in metres, found {list(self.size)}"
            )
        if not (np.abs([*self.size, *self.position]) <= FARTHEST_M).all():
            raise CellError(
                f"part: expected size and position in metres, at most {FARTHEST_M:g}, found {list(self.size)} and "
                f"{list(self.position)}"
            )

    @property
    def shape(self) -> Shape:
        """The primitive in its own frame."""
        return Shape(Form(self.form), self.size)

    @cached_property
    def T_body_part(self) -> Float64:
        """[4, 4] maps the primitive's coordinates to the body's."""
        from scipy.spatial.transform import Rotation  # loads slowly, and who only reads a scenario never asks

        return pose(Rotation.from_euler("xyz", self.rpy_deg, degrees=True).as_matrix(), np.array(self.position))


@dataclass(frozen=True)
class Body:
    """A rigid body: one or more parts on a path."""

    name: str = ""
    parts: tuple[Part, ...] = ()
    path: Path = field(default_factory=Path)

    def __post_init__(self) -> None:
        if not self.parts:
            raise CellError(f"body '{self.name}': expected at least one part under 'parts', found none")


@dataclass(frozen=True)
class BvhMotion:
    """A motion capture file (BVH, y up) that a whole body follows; before and after it the body stands still."""

    file: str = ""
    """Beside the scenario file that names it, or a path."""
    position: Triple = (1.3, 0.0, -0.81)
    """Where the hips are at `from_s` (x, y), and the height of the ground (z), m."""
    yaw_deg: float = 0.0
    """Turn about z; at 0 the file's z axis, to which most recordings face, is x."""
    start_s: float = 0.0
    """When the recording begins, s after the scenario's start."""
    from_s: float = 0.0
    """Where in the recording to begin, s."""
    to_s: float = 1e9
    """Where in the recording to end, s."""
    pace: float = 1.0
    """How many seconds of the recording go by in one."""

    def __post_init__(self) -> None:
        if not self.file:
            raise CellError("motion: expected a BVH file under 'file', found none")
        if not 0.05 <= self.pace <= 20 or not 0 <= self.from_s < self.to_s:
            raise CellError(
                f"motion '{self.file}': expected pace from 0.05 to 20 and 0 <= from_s < to_s, "
                f"found {self.pace}, {self.from_s} and {self.to_s}"
            )
        if not (np.abs(self.position) <= FARTHEST_M).all():
            raise CellError(
                f"motion '{self.file}': expected position in metres, at most {FARTHEST_M:g} from base_link, found "
                f"{list(self.position)}"
            )


@dataclass(frozen=True)
class Person:
    """A person of capsules: standing, the right hand on a path, or the whole body on a recorded motion.

    Limb lengths are fractions of the height; those of a recorded motion are its own, scaled to the height.
    """

    name: str = "person"
    motion: BvhMotion | None = None
    """Takes the place of `shoulder` and `hand`."""
    shoulder: Path = field(default_factory=Path)
    """The right shoulder; yaw is the way the person faces (0: along +x)."""
    hand: Path = field(default_factory=Path)
    """The middle of the right hand; held at the arm's length where it is out of reach."""
    height_m: float = 1.75
    shirt: Texture = SHIRT
    skin: Texture = SKIN
    trousers: Texture = TROUSERS

    def __post_init__(self) -> None:
        check_ranges(self, CellError, f"person '{self.name}': ", height_m=Range(0.3, 3))


@dataclass(frozen=True)
class CameraSpec:
    """A pinhole RGB-D camera."""

    name: str = ""
    position: Triple = (1.0, 0.0, 1.0)
    """Optical centre, m in `base_link`."""
    look_at: Triple = (0.0, 0.0, 0.0)
    """Point in the middle of the image, m."""
    fov_deg: float = 65.0
    """Horizontal field of view."""
    skew_ms: float = 0.0
    """Constant delay of this camera's exposures behind the rig's tick."""
    gain: float = 1.0
    """Brightness of its images: cameras are rarely set alike."""

    def __post_init__(self) -> None:
        if not is_camera_name(self.name):
            raise CellError(f"camera: expected {NAME_WANTED}, as topics are named after it, found '{self.name}'")
        if not 0 < self.fov_deg < 180:
            raise CellError(f"camera '{self.name}': fov_deg must lie between 0 and 180, found {self.fov_deg}")
        ranges = {"skew_ms": Range(-10_000, 10_000), "gain": Range(0, 16, above=True)}
        check_ranges(self, CellError, f"camera '{self.name}': ", **ranges)
        if not (np.abs([self.position, self.look_at]) <= FARTHEST_M).all():
            raise CellError(
                f"camera '{self.name}': expected position and look_at in metres, at most {FARTHEST_M:g} from "
                f"base_link, found {list(self.position)} and {list(self.look_at)}"
            )
        if self.position == self.look_at:
            raise CellError(f"camera '{self.name}': look_at must differ from position, both are {self.position}")


@dataclass(frozen=True)
class Fault:
    """Something wrong with one camera's stream for a while."""

    kind: str = "frozen"
    """nan_depth: depth in 32FC1, all NaN; unsorted_stamps: every second image is stamped 50 ms early; missing: no
    images; frozen: the same image again and again under new stamps; bumped: the camera is turned by `turn_deg`."""
    camera: str = ""
    from_s: float = 0.0
    to_s: float = 1e9
    turn_deg: float = 1.0
    """How far a bumped camera is turned, about its vertical axis."""

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            raise CellError(f"fault: kind must be one of {', '.join(FAULTS)}, found '{self.kind}'")
        if not self.from_s < self.to_s:
            raise CellError(
                f"fault '{self.kind}': expected from_s before to_s, found {self.from_s:g} and {self.to_s:g}; it would "
                "never be"
            )


@dataclass(frozen=True)
class Sensing:
    """How the cameras sample and err."""

    width: int = 320
    height: int = 240
    rate_hz: float = 30.0
    jitter_ms: float = 1.0
    """1 sigma of an exposure's time about its tick (cut at 3 sigma); the stamp tells the true time."""
    latency_ms: float = 0.0
    """From the end of an exposure until its image arrives, in logs and in the closed loop: readout, encoding and
    transport. Live images come when they are made."""
    latency_jitter_ms: float = 0.0
    """1 sigma of what arrives later still (half a normal distribution, cut at 3 sigma)."""
    exposure_ms: float = 0.0
    """How long the shutter is open, at most the period: what moves meanwhile is blurred (not in depth). 0: no blur."""
    rgb_sigma: float = 2.0
    """1 sigma of the colour noise, levels of 255."""
    depth_sigma_at_1m_mm: float = 2.0
    """1 sigma of the depth noise at 1 m; grows with the square of the depth, as for stereo (Khoshelham 2012)."""
    depth_dropout: float = 0.005
    """Share of depth pixels without a value anywhere."""
    edge_dropout: float = 0.5
    """The same within a pixel of a depth step, which a stereo matcher straddles."""

    def __post_init__(self) -> None:
        size, late, noise = Range(1, 16_384), Range(0, 10_000), Range(0, 100_000)
        check_ranges(
            self,
            CellError,
            "sensing: ",
            width=size,
            height=size,
            rate_hz=Range(0, 1000, above=True),
            latency_ms=late,
            latency_jitter_ms=late,
            exposure_ms=late,
            rgb_sigma=noise,
            depth_sigma_at_1m_mm=noise,
            depth_dropout=SHARE,
            edge_dropout=SHARE,
        )
        if not 0 <= self.jitter_ms < 1000 / self.rate_hz / 6:
            raise CellError(
                f"sensing: jitter_ms must be from 0 to under a sixth of the period ({1000 / self.rate_hz / 6:.2f} ms), "
                f"so that a camera's images keep their order, found {self.jitter_ms}"
            )
        if self.exposure_ms > 1000 / self.rate_hz:
            raise CellError(
                f"sensing: exposure_ms must be at most the period ({1000 / self.rate_hz:.2f} ms), as a shutter is open "
                f"for one image at a time, found {self.exposure_ms:g}"
            )


@dataclass(frozen=True)
class ArmSpec:
    """The UR arm of the cell, which follows its default pick-and-place path."""

    model: str = "ur5e"
    workspace: tuple[Triple, Triple] | None = None
    """Lower and upper corner of where it picks and places, m; None: the scenario's."""
    cycle: CycleParameters = field(default_factory=CycleParameters)
    """How fast its program runs."""
    joint_rate_hz: float = 125.0
    """Rate of the joint states (a UR e-series controller allows up to 500 Hz)."""
    texture: Texture = ARM_PAINT

    def __post_init__(self) -> None:
        if self.model not in UR_NAMES:
            raise CellError(
                f"arm: model: expected one of {', '.join(UR_NAMES)}, found '{self.model}'; other arms, and those of "
                "files, are not simulated"
            )
        if self.workspace is not None:
            _require_corners("arm", self.workspace)
        check_ranges(self, CellError, "arm: ", joint_rate_hz=Range(0, 1000, above=True))
        speeds = {"speed": Range(0.01, 100), "acceleration": Range(0.01, 1000)}
        check_ranges(self.cycle, CellError, "arm: cycle.", **speeds, dwell_s=Range(0, 3600), lift_m=Range(0, 10))


@dataclass(frozen=True)
class Variation:
    """How far a seed moves what acts away from the scenario as written."""

    position_m: float = 0.0
    """1 sigma of one shift per body or person."""
    time_s: float = 0.0
    """1 sigma of one delay per body or person."""
    pace: float = 0.0
    """1 sigma of the logarithm of one factor on the speed per body or person; what is thrown falls as fast as ever."""

    def __post_init__(self) -> None:
        check_ranges(
            self, CellError, "variation: ", position_m=Range(0, FARTHEST_M), time_s=NOT_NEGATIVE, pace=Range(0, 3)
        )


@dataclass(frozen=True)
class Scenario:
    """A cell, what acts in it, and what looks at it. Times are seconds after the start."""

    name: str = "cell"
    seed: int = 0
    duration_s: float = 8.0
    start_ns: int = 1_700_000_000_000_000_000
    """Stamp of the start, ns."""
    workspace: tuple[Triple, Triple] = ((0.0, -0.6, 0.0), (1.0, 0.6, 0.8))
    """Lower and upper corner of the modelled volume, m in `base_link`."""
    voxel_size_m: float = 0.02
    """Of the recorded truth."""
    furniture: tuple[Body, ...] = ()
    """What stands still; paths have one waypoint."""
    bodies: tuple[Body, ...] = ()
    """What moves by itself: never furniture to the truth, even while it rests."""
    people: tuple[Person, ...] = ()
    cameras: tuple[CameraSpec, ...] = ()
    sensing: Sensing = field(default_factory=Sensing)
    arm: ArmSpec | None = None
    variation: Variation = field(default_factory=Variation)
    faults: tuple[Fault, ...] = ()

    def __post_init__(self) -> None:
        where = f"scenario '{self.name}'"
        bodies = [body.name for body in (*self.furniture, *self.bodies)]
        _require_names(where, "body or person", bodies + [person.name for person in self.people])
        _require_names(where, "camera", [camera.name for camera in self.cameras])
        for body in self.furniture:
            if body.path.moves:
                raise CellError(f"{where}: furniture '{body.name}' has a path that moves; put it under 'bodies'")
        if not self.cameras:
            raise CellError(f"{where}: expected at least one camera under 'cameras', found none")
        ranges = {"duration_s": Range(0, 3600, above=True), "start_ns": Range(0, 2_000_000_000_000_000_000)}
        check_ranges(self, CellError, f"{where}: ", seed=NOT_NEGATIVE, **ranges)
        if self.duration_s * self.sensing.rate_hz < 1:
            raise CellError(
                f"{where}: expected time for one image set at least, found duration_s {self.duration_s:g} at rate_hz "
                f"{self.sensing.rate_hz:g}; make it longer"
            )
        _require_corners(where, self.workspace)
        self._require_voxels(where)
        self._require_stamps(where)
        known = {camera.name for camera in self.cameras}
        for fault in self.faults:
            if fault.camera not in known:
                cameras = ", ".join(sorted(known))
                raise CellError(
                    f"{where}: fault '{fault.kind}' names camera '{fault.camera}'; known cameras: {cameras}"
                )

    def _require_stamps(self, where: str) -> None:
        """Raises `CellError` where an image could be stamped before 0 ns."""
        sensing = self.sensing
        unsorted = {fault.camera for fault in self.faults if fault.kind == "unsorted_stamps"}
        for camera in self.cameras:
            first_ms = 500 / sensing.rate_hz
            if camera.name in unsorted:  # of two images the second
                first_ms = min(first_ms, 1500 / sensing.rate_hz - UNSORTED_STEP_NS / 1e6)
            first_ms += camera.skew_ms - 3 * sensing.jitter_ms
            if self.start_ns + first_ms * 1e6 < 0:
                raise CellError(
                    f"{where}: camera '{camera.name}': expected stamps from 0 ns on, found skew_ms {camera.skew_ms:g} "
                    f"with which its first image may be stamped {-self.start_ns / 1e6 - first_ms:.0f} ms before; raise "
                    "start_ns or skew_ms"
                )

    def _require_voxels(self, where: str) -> None:
        """Raises `CellError` for a voxel size that is none, and for more of them than can be."""
        check_ranges(self, CellError, f"{where}: ", voxel_size_m=Range(0, 1, above=True))
        extent = np.subtract(self.workspace[1], self.workspace[0])
        voxels = float(np.prod(np.ceil(extent / self.voxel_size_m)))
        if not voxels <= MOST_VOXELS:
            raise CellError(
                f"{where}: expected at most {MOST_VOXELS} voxels, found {voxels:.3g} of {self.voxel_size_m:g} m in a "
                f"workspace of {' x '.join(f'{side:g}' for side in extent)} m; give metres"
            )

    def with_seed(self, seed: int) -> Scenario:
        """The same scenario under another seed: other noise and stamps, and other motion where it varies."""
        return replace(self, seed=seed)

    def at_width(self, width: int) -> Scenario:
        """The same scenario by cameras whose images are so wide, px, and keep their shape."""
        height = max(round(self.sensing.height * width / self.sensing.width), 1)
        return replace(self, sensing=replace(self.sensing, width=width, height=height))


def _require_corners(where: str, workspace: tuple[Triple, Triple]) -> None:
    if np.any(np.array(workspace[0]) >= np.array(workspace[1])):
        raise CellError(f"{where}: workspace must be a lower and an upper corner, found {workspace}")


def _require_names(where: str, kind: str, names: list[str]) -> None:
    for i, name in enumerate(names):
        if not name or name in names[:i]:
            raise CellError(f"{where}: every {kind} needs a name of its own, found '{name}' as number {i + 1}")
