"""Where a camera is on the robot, or beside it: AX = XB and robot-world calibration, refined by reprojection.

One equation covers both mounts: `T_camera_target = X^-1 G Y`, with X the camera's and Y the target's pose in what
carries them. Camera on the flange: X in the flange, Y in the base, G base to flange. Target on the flange: X in the
base, Y in the flange, G flange to base.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.hand_eye_fit import HandEyeFit, HandEyeParameters
from twin_node.rig.calibrate.hand_eye_start import Loop, Stops, closed_form, numbered_alike, offsets
from twin_node.rig.errors import RigError
from twin_node.scene import Bool, Float64, RigCamera

MIN_VIEWS = 4
"""Three motions are the least that tell the poses and leave something to check them by."""
MIN_POINTS = 6
"""What a pose can be found from with a point to spare in each direction."""
MIN_TURN = np.radians(3)
"""Turns between views below this say more of noise than of an axis."""
MIN_AXES_SPREAD = 0.02
"""Second-largest share of the axes of turns: below it (8 degrees) the robot has turned about one axis alone."""
OUTLIER = 2.5
"""A view whose mean error is so many times the median view's is left out: its pose or its picture is wrong."""
GROSS = 20.0
"""The same before anything is fitted: a closed form is rough, but a fit gives way to a pose that was mistyped."""
MOST_OFF = 0.003
"""Half of all corners fit within this share of the focal length (0.17 degrees): an arm whose stops are true to 2 mm and
0.2 degrees leaves a third of it, another mount than said, or other units, twice as much and more."""
MOST_SIGMA_M = 0.1
"""A camera's place that is open by more than this is none."""


class Mount(Enum):
    """What the flange carries."""

    CAMERA = "camera"
    TARGET = "target"


@dataclass(frozen=True)
class HandEyeView:
    """One stop of the robot."""

    name: str
    T_base_flange: Float64
    """[4, 4] maps flange coordinates to the robot's base."""
    pixels: Float64
    """[P, 2] raw pixels of the target's points in its order, OpenCV convention; NaN for those not seen."""
    T_base_flange_off: Float64 | None = None
    """[J, 4, 4] the pose were a joint of the arm off by 1 sigma, one after the other; None where no joints tell it."""


@dataclass(frozen=True)
class HandEyeResult:
    """A solved hand-eye calibration."""

    mount: Mount
    camera: RigCamera
    """With refined intrinsics where asked for; `T_base_cam` is set where the target is on the flange."""
    T_carrier_camera: Float64
    """[4, 4] pose of the optical frame in the flange (camera mounted) or in the base (target mounted)."""
    T_carrier_target: Float64
    """[4, 4] pose of the target in the base (camera mounted) or in the flange (target mounted)."""
    target_scale: float
    """True size of the target as a share of the size given."""
    scale_sigma: float
    """1 sigma of `target_scale`; 0 where the size was taken as given."""
    covariance: Float64
    """[6, 6] of `T_carrier_camera`: rotation vector (rad), then translation (m)."""
    residuals: Float64
    """[N, P] reprojection error of every point of the views that were used, pixels; NaN for points not seen."""
    dropped: tuple[str, ...]
    """Names of the views left out as outliers."""

    @property
    def mean_px(self) -> float:
        """Mean reprojection error, pixels."""
        return float(np.nanmean(self.residuals))

    @property
    def median_px(self) -> float:
        """Median reprojection error, pixels."""
        return float(np.nanmedian(self.residuals))

    @property
    def rms_px(self) -> float:
        """Root mean square reprojection error, pixels."""
        return float(np.sqrt(np.nanmean(self.residuals**2)))

    @property
    def sigma_m(self) -> float:
        """1 sigma of the camera's position (largest axis of its covariance), m."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1]))


def solve_hand_eye(
    camera: RigCamera,
    target: Float64,  # [P, 3] m
    views: Sequence[HandEyeView],
    mount: Mount,
    parameters: HandEyeParameters | None = None,
    *,
    numbered: bool = False,
) -> HandEyeResult:
    """Solves for the camera and the target from stops of the robot.

    `numbered`: the points' numbers are certain, as markers tell them. Otherwise a target that looks the same from
    several sides (a square grid of circles) may be numbered from any of its corners in each view: the numbering that
    fits the robot's motion is found. Views that disagree with the others are dropped and named.

    Raises `RigError` for too few views, where the robot did not turn about two axes, or where pictures and poses
    contradict each other.
    """
    parameters = parameters or HandEyeParameters()
    _check(target, views)
    stops = _stops(views, mount)
    _check_places(stops)
    if not numbered:
        stops = numbered_alike(camera, target, stops)
    kept = _agreeing(_errors(camera, target, stops, closed_form(camera, target, stops)), GROSS)
    solution = HandEyeFit(camera, target, stops.chosen(kept), parameters).solve()
    errors = _errors(solution.camera, target * solution.scale, stops, solution.loop)
    agreeing = _agreeing(errors, OUTLIER)
    if (agreeing != kept).any():
        kept = agreeing
        solution = HandEyeFit(camera, target, stops.chosen(kept), parameters).solve()
    refined, X = solution.camera, solution.loop.X
    result = HandEyeResult(
        mount,
        replace(refined, T_base_cam=X) if mount is Mount.TARGET else refined,
        X,
        solution.loop.Y,
        solution.scale,
        solution.scale_sigma,
        solution.covariance,
        solution.errors,
        tuple(view.name for view, used in zip(views, kept, strict=True) if not used),
    )
    _check_fit(result, camera)
    return result


def _stops(views: Sequence[HandEyeView], mount: Mount) -> Stops:
    """What carries the target as seen from what carries the camera, and where."""
    flanges = [
        view.T_base_flange[None] if view.T_base_flange_off is None else [view.T_base_flange, *view.T_base_flange_off]
        for view in views
    ]
    least = min(map(len, flanges))
    G = np.stack([own[:least] for own in flanges], axis=1)  # [1 + J, N, 4, 4]
    G = inverse_pose(G) if mount is Mount.CAMERA else G
    return Stops(G[0], np.stack([view.pixels for view in views]), G[1:])


def _errors(camera: RigCamera, target: Float64, stops: Stops, loop: Loop) -> Float64:
    """[N] mean reprojection error of every stop, pixels."""
    return np.asarray(np.nanmean(np.linalg.norm(offsets(camera, target, stops, loop), axis=2), axis=1))


def _agreeing(errors: Float64, most: float) -> Bool:
    """[N] which stops are at most so many times as far off as the median one; all where too few would be left."""
    kept = np.asarray(errors <= most * np.median(errors))
    return kept if kept.sum() >= MIN_VIEWS else np.ones(len(errors), dtype=bool)


def _check_fit(result: HandEyeResult, camera: RigCamera) -> None:
    if result.median_px <= MOST_OFF * camera.K[0, 0] and result.sigma_m <= MOST_SIGMA_M:
        return
    place = f" and the camera's place open by {result.sigma_m:.2g} m" if result.sigma_m > MOST_SIGMA_M else ""
    raise RigError(
        f"hand-eye: expected pictures that fit the poses of a flange that carries the {result.mount.value}, found "
        f"corners {result.median_px:.1f} px off{place}; check --mount, the lens, and that each pose is its picture's "
        "and maps the flange to the base (m; qx, qy, qz, qw)"
    )


def _check_places(stops: Stops) -> None:
    if (found := int(stops.places.max()) + 1) < MIN_VIEWS:
        raise RigError(
            f"hand-eye: expected stops at {MIN_VIEWS} different poses at least, found {found} in {len(stops.carried)} "
            "pictures; add stops"
        )


def _check(target: Float64, views: Sequence[HandEyeView]) -> None:
    if len(views) < MIN_VIEWS:
        raise RigError(f"hand-eye: expected at least {MIN_VIEWS} views of the target, found {len(views)}; add stops")
    for view in views:
        if view.pixels.shape != (len(target), 2):
            raise RigError(
                f"hand-eye: view {view.name}: expected {len(target)} points of the target, found {len(view.pixels)}"
            )
        if (seen := int(np.isfinite(view.pixels).all(1).sum())) < MIN_POINTS:
            raise RigError(f"hand-eye: view {view.name}: expected {MIN_POINTS} points of the target, found {seen}")
    flanges = [view.T_base_flange[:3, :3] for view in views]
    turns = np.stack([Rotation.from_matrix(a.T @ b).as_rotvec() for a, b in combinations(flanges, 2)])
    angles = np.linalg.norm(turns, axis=1)
    axes = turns[angles > MIN_TURN] / angles[angles > MIN_TURN, None]
    spread = np.linalg.eigvalsh(axes.T @ axes / len(axes))[1] if len(axes) else 0.0
    if spread < MIN_AXES_SPREAD:
        raise RigError(
            f"hand-eye: expected turns of the flange about at least two axes, found {'one' if len(axes) else 'none'}; "
            "add stops with the wrist tilted both ways by 20 degrees or more"
        )
