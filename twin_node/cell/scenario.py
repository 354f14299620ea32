"""What happens in a simulated cell: a scenario as data."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twin_node.cell.actors import ArmSpec, Body, Person, Triple, require_corners
from twin_node.cell.errors import CellError
from twin_node.cell.motion import FARTHEST_M
from twin_node.ranges import NOT_NEGATIVE, SHARE, Range, check_ranges
from twin_node.scene import NAME_WANTED, is_camera_name

FAULTS = ("nan_depth", "unsorted_stamps", "missing", "frozen", "bumped")
"""Faults a camera can be given."""

UNSORTED_STEP_NS = 50_000_000
"""How early every second image is stamped under the fault `unsorted_stamps`."""

MOST_SHARED_PX = 50.0
"""Pixels that depth noise may hang together over, 1 sigma."""
MOST_VOXELS = 100_000_000
"""Of the recorded truth: more are lengths in millimetres, or voxels smaller than anybody looks at."""


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
    depth_noise_px: float = 0.0
    """How far that hangs together, 1 sigma, pixels: a stereo matcher compares windows. 0: each pixel has its own."""
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
            depth_noise_px=Range(0, MOST_SHARED_PX),
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
        require_corners(where, self.workspace)
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
        sensing, share = self.sensing, width / self.sensing.width
        height, shared_px = max(round(sensing.height * share), 1), min(sensing.depth_noise_px * share, MOST_SHARED_PX)
        return replace(self, sensing=replace(sensing, width=width, height=height, depth_noise_px=shared_px))


def _require_names(where: str, kind: str, names: list[str]) -> None:
    for i, name in enumerate(names):
        if not name or name in names[:i]:
            raise CellError(f"{where}: every {kind} needs a name of its own, found '{name}' as number {i + 1}")
