"""Clock offsets and rates of cameras from what moves: against the arm where its joints are known, else each other.

Against the arm: `arm_motion` roughly, then `arm_features`. Against each other: every image is summed up as how much of
each epipolar plane shows something that is not in the median image; how these sums change agrees between two cameras,
plane by plane, when their clocks do (after Kasten, Ben-Artzi, Peleg and Werman, "Fundamental matrices from moving
objects using line motion barcodes", ECCV 2016). The two see different sides of a thing, so this is good to 10 or 20 ms
only.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from twin_node.rig.calibrate.arm_features import ArmClock, time_by_features
from twin_node.rig.calibrate.arm_motion import STEP_S, ArmCourse, Film, JointCourse
from twin_node.rig.calibrate.islands import islands
from twin_node.rig.calibrate.shifts import Costs, Shift, best_shift
from twin_node.rig.errors import RigError
from twin_node.robot import ArmModel
from twin_node.scene import Camera, Float64, FrameSet, JointSample, RigCamera, UInt8

PLANES = 64
"""Epipolar planes that a pair's common view is divided into: a few pixels each at the working width."""
LEAST_PIXELS = 8
"""A plane that fewer pixels of either image belong to is left out."""
FOREGROUND_LEVELS = 24.0
"""Grey levels off the median at which a pixel counts half as moving: above video noise, below most things' contrast."""
MOST_MEDIAN_IMAGES = 60
LEAST_IMAGES = 20
"""Images per camera below which motion tells no time."""
FLOW_SIGMA_NS = 4_000_000
"""1 sigma of what flow alone is off by: measured on simulated cells with known clocks."""
BARCODE_SIGMA_NS = 15_000_000
"""1 sigma of what outlines seen from different sides are off by, however long the recording: measured on simulated
cells with known clocks."""
MAX_OFFSET_S = 0.15
"""Largest offset that is sought unless told otherwise, s."""
LEAST_JOINTS = 8
"""Joint states that the arm's motion is told by."""
LEAST_CONTRAST = 0.02
"""How much worse than the best the median shift must fit for a pair to tell anything."""


@dataclass(frozen=True)
class CameraClock:
    """A camera's clock against the reference: the arm's joints, or the first camera."""

    name: str
    offset_ns: int
    """To be added to the camera's stamps, beside what is added already, at `reference_ns`."""
    sigma_ns: int
    """1 sigma of `offset_ns`."""
    reference_ns: int
    """Stamp of the camera at which `offset_ns` holds, in whole seconds: files hold these exactly."""
    rate_ppm: float | None
    """How fast the offset grows, parts per million; None where the recording is too short to tell."""
    rate_sigma_ppm: float | None
    """1 sigma of `rate_ppm`; None where it was not estimated."""

    @property
    def certain(self) -> bool:
        """Whether the offset is more than what it may be wrong by (2 sigma)."""
        return abs(self.offset_ns) > 2 * self.sigma_ns

    @property
    def keeps_rate(self) -> bool:
        """Whether the rate is more than what it may be wrong by (3 sigma): a wrong one adds up for hours."""
        if self.rate_ppm is None or self.rate_sigma_ppm is None:
            return False
        return abs(self.rate_ppm) > 3 * self.rate_sigma_ppm

    def ahead_of(self, shift_ns: int) -> CameraClock:
        """The clock of a camera whose stamps were taken to be `shift_ns` earlier than they are, when this was found."""
        return replace(self, offset_ns=self.offset_ns - shift_ns, reference_ns=self.reference_ns + shift_ns)

    def applied(self, camera: RigCamera) -> RigCamera:
        """A camera whose clock is corrected by this, beside what corrected its stamps already."""
        rate = self.rate_ppm if self.rate_ppm is not None and self.keeps_rate else 0.0
        own = camera.own_time(self.reference_ns)
        both = (1 + rate * 1e-6) * (1 + camera.time_rate_ppm * 1e-6) - 1
        return replace(
            camera,
            time_offset_ns=self.reference_ns + self.offset_ns - own,
            time_rate_ppm=both * 1e6,
            time_reference_ns=own,
        )


@dataclass(frozen=True)
class ClockResult:
    """Clocks of all cameras."""

    reference: str
    """The arm's name or the first camera's."""
    cameras: tuple[CameraClock, ...]


def calibrate_clocks(
    cameras: Sequence[Camera],
    sets: Iterable[FrameSet],
    arm: ArmModel | None = None,
    max_offset_s: float = MAX_OFFSET_S,
) -> ClockResult:
    """Clock offsets of the cameras of `sets` from what moves: against the joints of `arm`, or without it each other.

    Offsets of more than `max_offset_s` are not found.

    Raises `RigError` naming a camera that sees too little motion, the arm where its joints are not told, or an offset
    that no instant of the recording could be tried with.
    """
    joints: list[JointSample] = []
    films = _films(cameras, sets, joints)
    length_s = min(int(film.stamps[-1] - film.stamps[0]) for film in films) / 1e9
    if 2 * max_offset_s >= length_s:
        raise RigError(
            f"clocks: expected a largest offset of less than half the recording's {length_s:.1f} s, found "
            f"{max_offset_s:g} s; give it in seconds, or a longer recording"
        )
    if arm is not None:
        if len(joints) < LEAST_JOINTS:
            raise RigError(
                f"arm {arm.name}: expected at least {LEAST_JOINTS} joint states to time cameras by, found "
                f"{len(joints)}; record them with the images"
            )
        return ClockResult(arm.name, _against_arm(JointCourse(arm, joints), films, max_offset_s))
    return ClockResult(cameras[0].name, _against_each_other(films, max_offset_s))


def _against_arm(joints: JointCourse, films: Sequence[Film], max_offset_s: float) -> tuple[CameraClock, ...]:
    clocks, rough = [], ArmCourse(joints)
    for film in films:
        costs = rough.costs(film, max_offset_s)
        shift = None if costs is None else best_shift(costs)
        if shift is None or shift.contrast < LEAST_CONTRAST:
            raise RigError(
                f"camera {film.camera.name}: expected to see the arm move, found no motion that fits its joints; "
                "record it moving fast and with changing speed where all cameras see it, and check the extrinsics"
            )
        fine = time_by_features(joints, film, shift.offset_ns / 1e9)
        clocks.append(_by_flow(film, shift) if fine is None else _by_features(film, joints.start, fine))
    return tuple(clocks)


def _by_flow(film: Film, shift: Shift) -> CameraClock:
    """The clock where the arm shows nothing that can be followed."""
    sigma = round(float(np.hypot(shift.sigma_ns, FLOW_SIGMA_NS)))
    return CameraClock(film.camera.name, shift.offset_ns, sigma, _middle(film), shift.rate_ppm, None)


def _by_features(film: Film, start: int, clock: ArmClock) -> CameraClock:
    reference = _middle(film)
    since = (reference - start) / 1e9 - clock.reference_s
    by = np.array([1.0, since])
    sigma = float(np.sqrt(by @ clock.covariance @ by))
    return CameraClock(
        film.camera.name,
        round(1e9 * (clock.offset_s + clock.rate * since)),
        round(1e9 * sigma),
        reference,
        1e6 * clock.rate,
        1e6 * float(np.sqrt(clock.covariance[1, 1])),
    )


def _middle(film: Film) -> int:
    """The whole second nearest to the middle of a film, ns."""
    return round(int(film.stamps[0] + film.stamps[-1]) / 2e9) * 1_000_000_000


def _against_each_other(films: Sequence[Film], max_offset_s: float) -> tuple[CameraClock, ...]:
    if len(films) < 2:
        raise RigError(
            f"camera {films[0].camera.name}: expected another camera or the arm to time it by, found neither"
        )
    moving = [_moving(film) for film in films]
    edges = []
    for a, b in combinations(range(len(films)), 2):
        if np.array_equal(films[a].camera.T_base_cam[:3, 3], films[b].camera.T_base_cam[:3, 3]):
            continue  # two of one place have no epipolar planes
        planes = _EpipolarPlanes(films[a].camera, films[b].camera)
        costs = _barcode_costs(
            _Barcode(films[a].stamps, planes.sums(moving[a], 0)),
            _Barcode(films[b].stamps, planes.sums(moving[b], 1)),
            max_offset_s,
        )
        shift = None if costs is None else best_shift(costs)
        if shift is not None and shift.contrast >= LEAST_CONTRAST:
            edges.append(_Edge(a, b, shift))
    return _reconciled(films, edges)


@dataclass(frozen=True)
class _Barcode:
    stamps: NDArray[np.int64]
    values: Float64
    """[T, planes]."""


@dataclass(frozen=True)
class _Edge:
    a: int
    b: int
    shift: Shift
    """To be added to b's stamps to agree with a's."""


class _EpipolarPlanes:
    """Pixels of two cameras sorted by the epipolar plane that they lie in."""

    def __init__(self, a: Camera, b: Camera) -> None:
        baseline = b.T_base_cam[:3, 3] - a.T_base_cam[:3, 3]
        angles = [_angles(camera, baseline / max(float(np.linalg.norm(baseline)), 1e-9)) for camera in (a, b)]
        low, high = _common_range(*angles)
        bins = [np.floor((angle - low) / (high - low) * PLANES).astype(np.int64) for angle in angles]
        self._inside = [(number >= 0) & (number < PLANES) for number in bins]
        self._bins = [number[inside] for number, inside in zip(bins, self._inside, strict=True)]
        counts = [np.bincount(number, minlength=PLANES) for number in self._bins]
        self._shared = (counts[0] >= LEAST_PIXELS) & (counts[1] >= LEAST_PIXELS)

    def sums(self, moving: UInt8, which: int) -> Float64:
        """[T, planes] logarithm of how many pixels move in each shared plane; `moving` [T, H, W], 255 is certain."""
        inside, bins = self._inside[which], self._bins[which]
        rows = [np.bincount(bins, weights=image.ravel()[inside], minlength=PLANES) for image in moving]
        out: Float64 = np.log1p(np.stack(rows)[:, self._shared] / 255)
        return out


def _barcode_costs(a: _Barcode, b: _Barcode, max_offset_s: float) -> Costs | None:
    """Squared differences of how the sums change, at every shift of b's stamps; None where nothing changes."""
    origin = a.stamps[0]
    t_a, t_b = (a.stamps - origin) / 1e9, (b.stamps - origin) / 1e9
    change_a, course_b = np.gradient(a.values, t_a, axis=0), CubicSpline(t_b, np.gradient(b.values, t_b, axis=0))
    shifts = np.arange(-np.ceil(max_offset_s / STEP_S), np.ceil(max_offset_s / STEP_S) + 1) * STEP_S
    rows = (t_a > t_b[0] + max_offset_s) & (t_a < t_b[-1] - max_offset_s)
    if not rows.any() or not change_a[rows].any():
        return None
    scale_a, scale_b = change_a[rows].std(), max(float(course_b(t_a[rows]).std()), 1e-9)
    x = change_a[rows] / scale_a
    values = [((x - course_b(t_a[rows] - shift) / scale_b) ** 2).mean(1) for shift in shifts]
    return Costs(a.stamps[rows], shifts, np.stack(values, axis=1))


def _angles(camera: Camera, baseline: Float64) -> Float64:
    """[H * W] angle (rad) about the baseline of every pixel's ray, from downwards; from x about one that is upright."""
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    local = np.stack(
        [(u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1], np.ones_like(u)], -1
    )
    rays = local.reshape(-1, 3) @ camera.T_base_cam[:3, :3].T
    down = np.array([0.0, 0.0, -1.0]) if abs(baseline[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    across = np.cross(baseline, down)
    across /= np.linalg.norm(across)
    out: Float64 = np.arctan2(rays @ across, rays @ np.cross(across, baseline))
    return out


def _common_range(a: Float64, b: Float64) -> tuple[float, float]:
    """Angles between which both cameras see."""
    low, high = max(a.min(), b.min()), min(a.max(), b.max())
    return (float(low), float(high)) if high > low else (-np.pi, np.pi)


def _films(cameras: Sequence[Camera], sets: Iterable[FrameSet], joints: list[JointSample]) -> list[Film]:
    """Every camera's images in the order of their stamps; fills `joints` with those whose stamps rise."""
    images: dict[str, list[UInt8]] = {camera.name: [] for camera in cameras}
    stamps: dict[str, list[int]] = {camera.name: [] for camera in cameras}
    for frames in sets:
        if frames.joints is not None and (not joints or frames.joints.stamp > joints[-1].stamp):
            joints.append(frames.joints)
        for view in frames.views:
            images[view.camera.name].append(np.asarray(cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY), np.uint8))
            stamps[view.camera.name].append(view.stamp)
    for camera in cameras:
        if (found := len(images[camera.name])) < LEAST_IMAGES:
            raise RigError(
                f"camera {camera.name}: expected at least {LEAST_IMAGES} images to time its motion by, found {found}; "
                "use a longer recording"
            )
    return [Film(camera, np.array(stamps[camera.name]), np.stack(images[camera.name])) for camera in cameras]


def _moving(film: Film) -> UInt8:
    """[T, H, W] how surely each pixel shows something that is not in the median image, 255 is certain."""
    median = np.median(film.grey[:: max(len(film.grey) // MOST_MEDIAN_IMAGES, 1)], axis=0).astype(np.float32)
    out = np.empty_like(film.grey)
    for i, image in enumerate(film.grey):
        off = (image - median) ** 2
        out[i] = 255 * off / (off + FOREGROUND_LEVELS**2)
    return out


def _reconciled(films: Sequence[Film], edges: Sequence[_Edge]) -> tuple[CameraClock, ...]:
    """Offsets of all cameras that fit those of the pairs best, weighted by how sure each pair is."""
    names = [film.camera.name for film in films]
    offsets = np.zeros(len(names))
    rows, wanted, rates, weights = [], [], [], []
    for edge in edges:
        row = np.zeros(len(names))
        row[edge.b], row[edge.a] = 1.0, -1.0
        rows.append(row)
        wanted.append(edge.shift.offset_ns)
        rates.append(np.nan if edge.shift.rate_ppm is None else edge.shift.rate_ppm)
        weights.append(1 / np.hypot(edge.shift.sigma_ns, BARCODE_SIGMA_NS))
    _, *apart = islands(len(names), [(edge.a, edge.b) for edge in edges])
    if apart:
        raise RigError(
            f"camera {names[apart[0][0]]}: expected motion that another camera sees too, found none that agrees; "
            "record something that moves where all cameras see it, and check the extrinsics"
        )
    A, w = np.array(rows)[:, 1:], np.array(weights)[:, None]
    solved = np.linalg.lstsq(A * w, np.array(wanted) * w[:, 0], rcond=None)[0]
    offsets[1:] = solved
    spread = np.linalg.pinv((A * w).T @ (A * w))
    sigmas = np.concatenate([[0.0], np.sqrt(np.diag(spread))])
    rate = np.linalg.lstsq(A * w, np.array(rates) * w[:, 0], rcond=None)[0] if np.isfinite(rates).all() else None
    return tuple(
        CameraClock(
            name,
            round(float(offsets[i])),
            round(float(sigmas[i])),
            _middle(films[0]),
            None if rate is None else (0.0 if i == 0 else float(rate[i - 1])),
            None,
        )
        for i, name in enumerate(names)
    )
