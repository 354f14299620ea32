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
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose, pose
from twin_node.rig.calibrate.hand_eye_start import Loop, Stops, closed_form, numbered_alike, offsets
from twin_node.rig.errors import RigError
from twin_node.scene import Float64, RigCamera

MIN_VIEWS = 4
"""Three motions are the least that tell the poses and leave something to check them by."""
MIN_POINTS = 6
"""What a pose can be found from with a point to spare in each direction."""
MIN_TURN = np.radians(3)
"""Turns between views below this say more of noise than of an axis."""
MIN_AXES_SPREAD = 0.02
"""Second-largest share of the axes of turns: below it (8 degrees) the robot has turned about one axis alone."""
ROBUST_PX = 1.0
"""Residuals above this count linearly: corners are found to a tenth of it, the arm is true to about as much."""
OUTLIER = 2.5
"""A view whose mean error is so many times the median view's is left out: its pose or its picture is wrong."""
FOCAL_SIGMA, CENTRE_SIGMA_PX, DISTORTION_SIGMA = 0.05, 20.0, 0.3
"""1 sigma of what refined intrinsics may change by: share of the focal length, pixels, coefficients."""
SCALE_SIGMA = 0.05
"""1 sigma of the target's printed size: printers that fit to the page are off by a few per cent."""

MOST_OFF = 0.003
"""Half of all corners fit within this share of the focal length (0.17 degrees): an arm whose stops are true to 2 mm and
0.2 degrees leaves a third of it, another mount than said, or other units, twice as much and more."""
MOST_STEPS = 200
"""Of a fit: poses of the pictures take up to 30, others would go on for thousands and be refused in the end."""
MOST_SIGMA_M = 0.1
"""A camera's place that is open by more than this is none."""


class Mount(Enum):
    """What the flange carries."""

    CAMERA = "camera"
    TARGET = "target"


@dataclass(frozen=True)
class HandEyeParameters:
    """What is solved for beside the two poses."""

    refine_intrinsics: bool = True
    """Free the focal lengths, the principal point and the distortion coefficients."""
    refine_scale: bool = True
    """Free the size of the target: the robot's own moves are the better ruler."""


@dataclass(frozen=True)
class HandEyeView:
    """One stop of the robot."""

    name: str
    T_base_flange: Float64
    """[4, 4] maps flange coordinates to the robot's base."""
    pixels: Float64
    """[P, 2] raw pixels of the target's points in its order, OpenCV convention; NaN for those not seen."""


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
    G = [inverse_pose(v.T_base_flange) if mount is Mount.CAMERA else v.T_base_flange for v in views]
    stops = Stops(np.stack(G), np.stack([view.pixels for view in views]))
    if not numbered:
        stops = numbered_alike(camera, target, stops)
    solution = _Adjustment(camera, target, stops, parameters).solve()
    worst = np.nanmean(solution.errors, axis=1)
    kept = worst <= OUTLIER * np.median(worst)
    if not kept.all() and kept.sum() >= MIN_VIEWS:
        solution = _Adjustment(camera, target, stops.chosen(kept), parameters).solve()
    else:
        kept = np.ones(len(views), dtype=bool)
    refined, X = solution.camera, solution.loop.X
    result = HandEyeResult(
        mount,
        replace(refined, T_base_cam=X) if mount is Mount.TARGET else refined,
        X,
        solution.loop.Y,
        solution.scale,
        solution.covariance,
        solution.errors,
        tuple(view.name for view, used in zip(views, kept, strict=True) if not used),
    )
    _check_fit(result, camera)
    return result


def _check_fit(result: HandEyeResult, camera: RigCamera) -> None:
    if result.median_px <= MOST_OFF * camera.K[0, 0] and result.sigma_m <= MOST_SIGMA_M:
        return
    place = f" and the camera's place open by {result.sigma_m:.2g} m" if result.sigma_m > MOST_SIGMA_M else ""
    raise RigError(
        f"hand-eye: expected pictures that fit the poses of a flange that carries the {result.mount.value}, found "
        f"corners {result.median_px:.1f} px off{place}; check --mount, the lens, and that each pose is its picture's "
        "and maps the flange to the base (m; qx, qy, qz, qw)"
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


@dataclass(frozen=True)
class _Solution:
    camera: RigCamera
    loop: Loop
    scale: float
    covariance: Float64
    errors: Float64


class _Adjustment:
    """Both poses, and the lens and the target's size where asked for, by robust least squares on the reprojection."""

    def __init__(self, camera: RigCamera, target: Float64, stops: Stops, parameters: HandEyeParameters) -> None:
        self._camera, self._target, self._stops = camera, target, stops
        self._start = closed_form(camera, target, stops)
        lens = [FOCAL_SIGMA * camera.K[0, 0]] * 2 + [CENTRE_SIGMA_PX] * 2 + [DISTORTION_SIGMA] * len(camera.D)
        self._sigmas = np.array([SCALE_SIGMA, *lens])
        """Of everything beside the poses: the target's scale, fx, fy, cx, cy, then the distortion."""
        self._free = np.array([parameters.refine_scale] + [parameters.refine_intrinsics] * len(lens))

    def solve(self) -> _Solution:
        """The best fit and how well it is known."""
        solved = least_squares(
            self._residuals,
            np.zeros(12 + self._free.sum()),
            loss="soft_l1",
            tr_solver="lsmr",
            x_scale="jac",
            max_nfev=MOST_STEPS,
        )
        stops, points, _ = self._stops.pixels.shape
        covariance = _covariance(np.asarray(solved.jac), np.asarray(solved.fun), stops, 2 * points)
        distances = np.linalg.norm(self._offsets(solved.x), axis=2)
        return _Solution(
            self._lens(solved.x), self._loop(solved.x), self._scale(solved.x), covariance[:6, :6], distances
        )

    def _residuals(self, x: Float64) -> Float64:
        priors = self._changes(x) / self._sigmas
        return np.concatenate([np.nan_to_num(self._offsets(x).ravel()) / ROBUST_PX, priors])

    def _offsets(self, x: Float64) -> Float64:
        return offsets(self._lens(x), self._target * self._scale(x), self._stops, self._loop(x))

    def _changes(self, x: Float64) -> Float64:
        out = np.zeros(len(self._sigmas))
        out[self._free] = x[12:]
        return out

    def _scale(self, x: Float64) -> float:
        return float(1 + self._changes(x)[0])

    def _lens(self, x: Float64) -> RigCamera:
        change = self._changes(x)[1:]
        K = self._camera.K.copy()
        K[[0, 1, 0, 1], [0, 1, 2, 2]] += change[:4]
        return replace(self._camera, K=K, D=self._camera.D + change[4:])

    def _loop(self, x: Float64) -> Loop:
        return Loop(_nudged(self._start.X, x[:6]), _nudged(self._start.Y, x[6:12]))


def _covariance(jac: Float64, residuals: Float64, stops: int, rows: int) -> Float64:
    """[n, n] of a fit to the residuals [M] of stops, `rows` each, then of priors; `jac` [M, n] as SciPy bends it.

    An arm that errs at a stop moves all corners there alike: stops count as one witness each, and their spread is what
    the fit would leave over without them (the jackknife; MacKinnon and White, J. Econometrics 1985, HC3 by clusters).
    """
    bent = residuals * (1 + residuals**2) ** 0.25  # J^T bent is the slope of the soft L1 cost
    inverse = np.linalg.pinv(jac.T @ jac)
    priors = jac[stops * rows :]
    spread = priors.T @ priors
    for i in range(stops):
        own = jac[i * rows : (i + 1) * rows]
        alone = np.eye(rows) - own @ inverse @ own.T
        slope = own.T @ np.linalg.lstsq(alone, bent[i * rows : (i + 1) * rows], rcond=1e-9)[0]
        spread += (stops - 1) / stops * np.outer(slope, slope)
    return np.asarray(inverse @ spread @ inverse)


def _nudged(T: Float64, change: Float64) -> Float64:
    """A pose turned by a rotation vector (rad) about its own origin, then moved (m), both in the outer frame."""
    return pose(Rotation.from_rotvec(change[:3]).as_matrix() @ T[:3, :3], T[:3, 3] + change[3:6])
