"""Camera and target of a hand-eye calibration by robust least squares on where the target's points are seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from twin_node.rig.calibrate.hand_eye_start import Loop, Stops, closed_form, offsets, seen_points
from twin_node.rig.calibrate.lenses import BEHIND_M, project
from twin_node.rig.calibrate.rotations import cross_matrix, moved, turning
from twin_node.scene import Float64, RigCamera

ROBUST_PX = 1.0
"""Residuals above this count linearly: corners are found to a tenth of it, the arm is true to about as much."""
FOCAL_SIGMA, CENTRE_SIGMA_PX, DISTORTION_SIGMA = 0.05, 20.0, 0.3
"""1 sigma of what refined intrinsics may change by: share of the focal length, pixels, coefficients."""
SCALE_SIGMA = 0.05
"""1 sigma of the target's printed size: printers that fit to the page are off by a few per cent."""
MOST_STEPS = 200
"""Of a fit: poses of the pictures take up to 30, others would go on for thousands and be refused in the end."""
POSES = 12
"""Numbers of both poses: rotation vector and translation of the camera, then of the target."""


@dataclass(frozen=True)
class HandEyeParameters:
    """What is solved for beside the two poses."""

    refine_intrinsics: bool = True
    """Free the focal lengths, the principal point and the distortion coefficients."""
    refine_scale: bool = True
    """Free the size of the target: the robot's own moves are the better ruler."""
    lens_sigmas: Float64 | None = None
    """[4 + D] 1 sigma of fx, fy, cx, cy (pixels) and the coefficients of a lens that is not refined, as its calibration
    states them; None: it is right. Of the coefficients, which err together, nothing is made."""


@dataclass(frozen=True)
class HandEyeSolution:
    """The best fit, and how well it is known."""

    camera: RigCamera
    """With refined intrinsics where asked for."""
    loop: Loop
    scale: float
    """True size of the target as a share of the size given."""
    covariance: Float64
    """[6, 6] of the camera's pose: rotation vector (rad), then translation (m)."""
    scale_sigma: float
    """1 sigma of `scale`; 0 where it was taken as it is."""
    errors: Float64
    """[N, P] reprojection error of every point, pixels; NaN for points not seen."""


class HandEyeFit:
    """Both poses, and the lens and the target's size where asked for, from a closed form's solution on."""

    def __init__(self, camera: RigCamera, target: Float64, stops: Stops, parameters: HandEyeParameters) -> None:
        self._camera, self._target, self._stops, self._parameters = camera, target, stops, parameters
        self._start = closed_form(camera, target, stops)
        lens = [FOCAL_SIGMA * camera.K[0, 0]] * 2 + [CENTRE_SIGMA_PX] * 2 + [DISTORTION_SIGMA] * len(camera.D)
        self._sigmas = np.array([SCALE_SIGMA, *lens])
        """Of everything beside the poses: the target's scale, fx, fy, cx, cy, then the distortion."""
        self._free = np.array([parameters.refine_scale] + [parameters.refine_intrinsics] * len(lens))
        self.size = POSES + int(self._free.sum())
        """Count of unknowns."""

    def solve(self) -> HandEyeSolution:
        """The best fit and how well it is known."""
        solved = least_squares(
            self.residuals,
            np.zeros(self.size),
            self.jacobian,
            loss="soft_l1",
            tr_solver="lsmr",
            x_scale="jac",
            max_nfev=MOST_STEPS,
        )
        rows = 2 * self._stops.pixels.shape[1]
        covariance = _covariance(np.asarray(solved.jac), np.asarray(solved.fun), self._stops.places, rows)
        shared = self._by_what_stops_share(solved.x)
        covariance += shared @ shared.T
        distances = np.linalg.norm(self._offsets(solved.x), axis=2)
        scale_sigma = float(np.sqrt(covariance[POSES, POSES])) if self._free[0] else 0.0
        return HandEyeSolution(
            self._lens(solved.x),
            self._loop(solved.x),
            self._scale(solved.x),
            covariance[:6, :6],
            scale_sigma,
            distances,
        )

    def residuals(self, x: Float64) -> Float64:
        """[2 N P + priors] in units of their noise; 0 for points that were not seen."""
        priors = self._changes(x) / self._sigmas
        return np.concatenate([np.nan_to_num(self._offsets(x).ravel()) / ROBUST_PX, priors])

    def jacobian(self, x: Float64) -> Float64:
        """[2 N P + priors, size] of the residuals."""
        loop, scale, carried = self._loop(x), self._scale(x), self._stops.carried
        back, turned = loop.X[:3, :3].T, np.tile(self._target @ loop.Y[:3, :3].T, (len(carried), 1))
        points = seen_points(self._target * scale, self._stops, loop).reshape(-1, 3)
        projection = project(self._lens(x), points)
        by_point = projection.by_point.copy()
        by_point[points[:, 2] <= BEHIND_M, :, 2] = 0  # they stay at that depth
        by_camera = by_point @ back  # by the point's place in what carries the camera
        by_target = (by_camera.reshape(len(carried), -1, 2, 3) @ carried[:, None, :3, :3]).reshape(-1, 2, 3)
        by_unknowns = [
            by_camera @ cross_matrix(points @ back) @ turning(x[:3]),
            -by_camera,
            -by_target @ cross_matrix(turned * scale) @ turning(x[6:9]),
            by_target,
            np.concatenate([by_target @ turned[..., None], projection.by_lens], axis=2)[..., self._free],
        ]
        out = np.concatenate(by_unknowns, axis=2).reshape(-1, self.size) / ROBUST_PX
        out[~np.isfinite(self._stops.pixels.ravel())] = 0
        priors = np.zeros((len(self._sigmas), self.size))
        priors[self._free, POSES:] = np.diag(1 / self._sigmas[self._free])
        return np.concatenate([out, priors])

    def _offsets(self, x: Float64) -> Float64:
        return offsets(self._lens(x), self._target * self._scale(x), self._stops, self._loop(x))

    def _by_what_stops_share(self, x: Float64) -> Float64:
        """[size, k] what the solution is off by where the lens, or a joint of the arm, is off by 1 sigma at all stops.

        No spread of the stops tells of that.
        """
        seen, target, loop = self._offsets(x), self._target * self._scale(x), self._loop(x)
        off = [offsets(lens, target, self._stops, loop) - seen for lens in self._lenses_off(x)]
        for carried in self._stops.carried_off:
            off.append(offsets(self._lens(x), target, replace(self._stops, carried=carried), loop) - seen)
        if not off:
            return np.zeros((self.size, 0))
        J, residuals = self.jacobian(x), self.residuals(x)
        weighted = J / np.sqrt(1 + residuals**2)[:, None]  # soft L1
        by_doubt = np.nan_to_num(np.stack([change.ravel() for change in off], axis=1)) / ROBUST_PX
        return np.asarray(np.linalg.pinv(weighted.T @ J) @ (weighted[: len(by_doubt)].T @ by_doubt))

    def _lenses_off(self, x: Float64) -> Iterator[RigCamera]:
        """The lens with its focal lengths, which err together, and each coordinate of its centre off by 1 sigma."""
        sigmas = self._parameters.lens_sigmas
        if self._parameters.refine_intrinsics or sigmas is None:
            return
        lens = self._lens(x)
        for rows, columns, change in (([0, 1], [0, 1], sigmas[:2]), (0, 2, sigmas[2]), (1, 2, sigmas[3])):
            K = lens.K.copy()
            K[rows, columns] += change
            yield replace(lens, K=K)

    def _changes(self, x: Float64) -> Float64:
        out = np.zeros(len(self._sigmas))
        out[self._free] = x[POSES:]
        return out

    def _scale(self, x: Float64) -> float:
        return float(1 + self._changes(x)[0])

    def _lens(self, x: Float64) -> RigCamera:
        change = self._changes(x)[1:]
        K = self._camera.K.copy()
        K[[0, 1, 0, 1], [0, 1, 2, 2]] += change[:4]
        return replace(self._camera, K=K, D=self._camera.D + change[4:])

    def _loop(self, x: Float64) -> Loop:
        return Loop(moved(self._start.X, x[:6]), moved(self._start.Y, x[6:POSES]))


def _covariance(jac: Float64, residuals: Float64, places: NDArray[np.int64], rows: int) -> Float64:
    """[n, n] of a fit to the residuals [M] of stops, `rows` each, then of priors; `jac` [M, n] as SciPy bends it.

    An arm that errs at a place moves all corners there alike, in every picture that it waits for: `places` [stops]
    count as one witness each, and their spread is what the fit would leave over without them (the jackknife; MacKinnon
    and White, J. Econometrics 1985, HC3 by clusters).
    """
    bent = residuals * (1 + residuals**2) ** 0.25  # J^T bent is the slope of the soft L1 cost
    inverse = np.linalg.pinv(jac.T @ jac)
    priors, count = jac[len(places) * rows :], int(places.max()) + 1
    spread = priors.T @ priors
    for place in range(count):
        # Only within the reach of its rows, n dimensions at most, does it matter that a place is away.
        there = np.flatnonzero(np.repeat(places == place, rows))
        reach, own = np.linalg.qr(jac[there])
        alone = np.eye(len(own)) - own @ inverse @ own.T
        slope = own.T @ np.linalg.lstsq(alone, reach.T @ bent[there], rcond=1e-9)[0]
        spread += (count - 1) / count * np.outer(slope, slope)
    return np.asarray(inverse @ spread @ inverse)
