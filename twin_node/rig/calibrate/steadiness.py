"""Whether cameras stood still, and their clocks ran on, while a board was recorded.

A camera that is moved half-way bends the whole fit, and delays of single images may take up most of what does not fit.
So each camera's later images are taken for those of another one, and what that would gain is told by one step. Few of
them may all have been left out instead: then they fit another place of the camera, as misread ones do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.geometry import pose, transform
from twin_node.rig.calibrate.bundle import BundleResult
from twin_node.rig.calibrate.bundle_solver import LEAST_SHARE
from twin_node.rig.calibrate.lenses import Lens, pixel_rays, project
from twin_node.rig.calibrate.rotations import apart
from twin_node.rig.calibrate.witnesses import MOST_GAIN, MOVED_M, MOVED_RAD, SET_S, Witnesses
from twin_node.rig.errors import RigError
from twin_node.scene import Bool, Float64

SHARES = 0.06, 0.5, 0.94
"""Of a camera's images, after which the others are taken for another one's: where it was moved shortly after the start
or before the end, its middle tells nothing."""

ELSEWHERE_IMAGES, ELSEWHERE_SIGMAS = 3, 10.0
"""So many images that were left out tell that their camera was moved where one place explains them all, to so many
sigma."""

DRAWS = 500
"""Of a few corners, to find that place."""


@dataclass(frozen=True)
class Split:
    """A camera's later images, as if another one had taken them."""

    camera: int
    late: Bool
    """[V] which of the witnesses these are."""
    gain: float
    """By how much half the sum of squares, in sigmas, would be less than it is, or can be with one camera."""
    shift_m: float
    """Between where the two would stand."""
    turn_rad: float
    later_s: float
    """By how much the other one's clock would be off."""

    @property
    def matters(self) -> bool:
        """Whether the two differ by more than what rigs are wanted to be right to."""
        return self.shift_m > MOVED_M or self.turn_rad > MOVED_RAD or abs(self.later_s) > SET_S

    @property
    def tells(self) -> bool:
        """Whether the two differ so, and not by chance."""
        return self.gain > MOST_GAIN and self.matters


def most_gained(witnesses: Witnesses) -> float:
    """By how much half the sum of squares, in sigmas, would be less at most, had one camera been moved meanwhile."""
    cameras = range(len(witnesses.bundle.state.lenses))
    return max((split.gain for camera in cameras for split in _splits(witnesses, camera)), default=0.0)


def check_steady(names: Sequence[str], witnesses: Witnesses) -> None:
    """Raises `RigError` where some of a camera's images are another camera's."""
    for camera, name in enumerate(names):
        if lost := _elsewhere(witnesses.bundle, camera):
            raise RigError(
                f"camera {name}: expected one place all along, found {lost} images that fit no place but another; was "
                "it moved meanwhile? Record it again, or leave out what lies before or after"
            )
    told = [split for camera in range(len(names)) for split in _splits(witnesses, camera)]
    for worst in sorted(told, key=lambda split: -split.gain):
        if not (worst.tells and _without_worst_image(witnesses, worst).tells):
            continue
        raise RigError(
            f"camera {names[worst.camera]}: expected one place and one clock all along, found its later images "
            f"{1e3 * worst.shift_m:.0f} mm, {np.degrees(worst.turn_rad):.1f} degrees and "
            f"{1e3 * abs(worst.later_s):.0f} ms off the earlier ones'; "
            "was it moved, focused or its clock set meanwhile? "
            "Record it again, or leave out what lies before or after"
        )


def _splits(witnesses: Witnesses, camera: int) -> list[Split]:
    """What one camera's images after each of `SHARES` would gain if they were another's."""
    times = np.array([sighting.time_s for sighting in witnesses.sightings])
    own = np.array([sighting.camera == camera for sighting in witnesses.sightings])
    lates = [own & (times > np.quantile(times[own], share)) for share in SHARES]
    return [_split(witnesses, camera, late) for late in lates if late.any()]


def _split(witnesses: Witnesses, camera: int, late: Bool) -> Split:
    """What a camera's `late` [V] images would gain."""
    other, two = len(witnesses.bundle.state.lenses), witnesses.divided(camera, late)
    there, later = two.place(other), two.change.outer[two.layout.clock(other)][:1].sum()
    later -= two.change.outer[two.layout.clock(camera)][:1].sum()
    shift_m, turn_rad = apart(two.place(camera), there)
    return Split(camera, late, two.gain - witnesses.undivided.gain, float(shift_m), float(turn_rad), float(later))


def _without_worst_image(witnesses: Witnesses, split: Split) -> Split:
    """The same without the camera's image that fits worst: two that were misread alike are no move.

    Where most of the fewer images, late or early, were left out, those that are left are what tells.
    """
    times = np.array([sighting.time_s for sighting in witnesses.sightings])
    own = np.array([sighting.camera == split.camera for sighting in witnesses.sightings])
    is_late = bool(split.late.sum() <= own.sum() / 2)
    fewer = own & (split.late == is_late)
    since, until = (times[fewer].min(), np.inf) if is_late else (-np.inf, times[fewer].max())
    lost = [s.time_s for s in witnesses.bundle.left_out if s.camera == split.camera]
    if sum(since <= time <= until for time in lost) > fewer.sum():
        return split
    worst = int(np.argmax(np.where(fewer, witnesses.misfits, -1.0)))
    return _split(witnesses.without(worst), split.camera, np.delete(split.late, worst))


def _elsewhere(bundle: BundleResult, camera: int) -> int:
    """Its first or last images, where they were all left out and fit one other place; 0 where too few tell that."""
    lost = [sighting for sighting in bundle.left_out if sighting.camera == camera]
    if len(lost) < ELSEWHERE_IMAGES:
        return 0
    state, lens = bundle.state, bundle.state.lenses[camera]
    placed = state.placed(lost)
    corners = np.concatenate(
        [
            state.points[sighting.corners.ids] @ R.T + p
            for sighting, R, p in zip(lost, placed.rotations, placed.positions, strict=True)
        ]
    )
    pixels = np.concatenate([sighting.corners.pixels for sighting in lost])
    tolerance_px = ELSEWHERE_SIGMAS * bundle.noise_px[camera]
    here = state.T_cam_rig[camera]
    there = _place_of_most(lens, corners, pixels, tolerance_px)
    if there is None:
        return 0
    shift_m, turn_rad = apart(here, there)
    if shift_m < MOVED_M and turn_rad < MOVED_RAD:
        return 0
    ends = np.cumsum([len(sighting.corners) for sighting in lost])[:-1]
    fits_here, fits_there = (
        np.array([image.mean() > LEAST_SHARE for image in np.split(off < tolerance_px, ends)])
        for off in (np.linalg.norm(project(lens, transform(T, corners)).pixels - pixels, axis=1) for T in (here, there))
    )
    kept = [sighting.time_s for sighting in bundle.sightings if sighting.camera == camera]
    alone = np.array([not min(kept) < sighting.time_s < max(kept) for sighting in lost])
    agreeing = int((fits_there & ~fits_here & alone).sum())
    return agreeing if agreeing >= ELSEWHERE_IMAGES else 0


def _place_of_most(lens: Lens, points: Float64, pixels: Float64, tolerance_px: float) -> Float64 | None:
    """[4, 4] from where a camera sees most of the points [N, 3] (m) at pixels [N, 2] (RANSAC); None: from nowhere."""
    found, rotation, translation, _ = cv2.solvePnPRansac(
        points,
        pixel_rays(lens, pixels)[:, None],
        np.eye(3),
        np.zeros(4),
        reprojectionError=tolerance_px / lens.K[0, 0],
        iterationsCount=DRAWS,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not found:
        return None
    turn = Rotation.from_rotvec(np.asarray(rotation, np.float64).ravel()).as_matrix()
    return pose(turn, np.asarray(translation, np.float64).ravel())
