"""Bundle adjustment of cameras on matches without points: through a common plane, and through epipolar lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from twin_node.geometry import pose
from twin_node.rig.calibrate.match_slopes import epipolar_slopes, transfer_slopes
from twin_node.rig.calibrate.matches import Matches, epipolar_px, transfer_px
from twin_node.rig.calibrate.rotations import turning
from twin_node.scene import Float64, RigCamera

PLANE_SIGMA = 0.02
"""1 sigma of a plane seen by a rough rig: tilts in rad, height in m."""
MOST_SIGMAS = 1e4
"""Errors are cut off there: solvers may try cameras that see a match from behind."""
POSE, LENS = 6, 3
"""Numbers per camera: rotation vector and translation; focal length and principal point."""
TURN_DEG, MOVE_M = 1.0, 0.01
"""1 sigma of how a camera stands beside how it is said to; the latter where its rig file does not say how well."""
FOCAL = 0.003
"""1 sigma of the focal length, a share of it: what factory calibrations are wrong by."""
CENTRE_PX = 1.0
"""1 sigma of the principal point, pixels of an image 480 wide; wider images in proportion."""
DISTORTION = (0.1, 0.15, 0.003, 0.003)
"""1 sigma of k1, k2, p1, p2 (k1 to k4 of a fisheye)."""
MATCH_PX = 3.0
"""1 sigma of a match in an image 480 wide, in proportion in wider ones; errors beyond it count linearly. Each is found
to a fifth of a pixel, but hundreds on one plane err together: they would bend the lens to explain a ripple of it."""


@dataclass(frozen=True)
class Adjusted:
    """Cameras and the plane as they are believed to be."""

    cameras: tuple[RigCamera, ...]
    plane: Float64 | None
    """[4] unit normal, offset in m."""
    strain: float = 0.0
    """Largest change of any number, in its own sigmas."""
    covariance: Float64 | None = None
    """[n, n] of the cameras' turns, moves and lenses, in the columns of `match_slopes.Slopes`, camera by camera; None
    before anything was adjusted. What matches do not tell is as open as the rig given was."""


def adjust_matches(cameras: Sequence[RigCamera], plane: Float64 | None, matches: Sequence[Matches]) -> Adjusted:
    """The cameras and plane nearest to those given, in their own sigmas, that explain the matches."""
    problem = MatchProblem(tuple(cameras), plane, matches)
    # LSMR: the dense solver's SVD of thousands of rows takes ten times as long as all the rest.
    solved = least_squares(
        problem.residuals,
        np.zeros(problem.size),
        problem.jacobian,
        loss="soft_l1",
        tr_solver="lsmr",
        ftol=1e-6,
        xtol=1e-6,
        max_nfev=40,
    )
    return replace(
        problem.state(solved.x),
        strain=float(np.abs(solved.x).max()),
        covariance=problem.covariance(solved.x, np.asarray(solved.jac)),
    )


class MatchProblem:
    """Unknowns are counted in their own sigmas, so that the prior is the vector itself."""

    def __init__(self, cameras: tuple[RigCamera, ...], plane: Float64 | None, matches: Sequence[Matches]) -> None:
        self._cameras, self._plane = cameras, plane
        self._matches = [pair for pair in matches if len(pair)]
        self._match_px = [MATCH_PX * camera.width / 480 for camera in cameras]
        self._sigmas = [_sigmas(camera) for camera in cameras]
        self._starts = np.cumsum([0] + [len(sigmas) for sigmas in self._sigmas])
        self.size = int(self._starts[-1]) + (3 if plane is not None else 0)

    def state(self, x: Float64) -> Adjusted:
        """The cameras and plane that unknowns stand for."""
        cameras = tuple(
            _changed(camera, x[start : start + len(sigmas)] * sigmas)
            for camera, sigmas, start in zip(self._cameras, self._sigmas, self._starts[:-1], strict=True)
        )
        return Adjusted(
            cameras, None if self._plane is None else _tilted(self._plane, x[-3:] * PLANE_SIGMA, self._cameras)
        )

    def residuals(self, x: Float64) -> Float64:
        """Matches in units of their noise, then the prior."""
        state = self.state(x)
        out = [x]
        for pair in self._matches:
            a, b = state.cameras[pair.a], state.cameras[pair.b]
            noise = max(self._match_px[pair.a], self._match_px[pair.b])
            if pair.on_plane and state.plane is not None:
                there = transfer_px(a, b, state.plane, pair.pixels_a, pair.pixels_b)
                back = transfer_px(b, a, state.plane, pair.pixels_b, pair.pixels_a)
                out += [there.ravel() / noise, back.ravel() / noise]
            else:
                out.append(epipolar_px(a, b, pair.pixels_a, pair.pixels_b) / noise)
        return np.clip(np.concatenate(out), -MOST_SIGMAS, MOST_SIGMAS)

    def jacobian(self, x: Float64) -> Float64:
        """[R, size] of the residuals."""
        state = self.state(x)
        by_unknowns = self._by_all(x)
        if self._plane is not None:
            by_tilt = _tilts(self._plane, x[-3:] * PLANE_SIGMA, self._cameras) * PLANE_SIGMA
        out = [np.eye(self.size)]
        for pair in self._matches:
            a, b = pair.a, pair.b
            cameras, pixels = (state.cameras[a], state.cameras[b]), (pair.pixels_a, pair.pixels_b)
            noise = max(self._match_px[a], self._match_px[b])
            if pair.on_plane and state.plane is not None:
                there = transfer_slopes(*cameras, state.plane, pixels[0])
                back = transfer_slopes(*cameras[::-1], state.plane, pixels[1])
                parts = [(there, a, b), (back, b, a)]
            else:
                parts = [(epipolar_slopes(*cameras, *pixels), a, b)]
            for slopes, first, second in parts:
                rows = np.zeros((len(slopes.by_a), self.size))
                for camera, by_camera in ((first, slopes.by_a), (second, slopes.by_b)):
                    rows[:, self._starts[camera] : self._starts[camera + 1]] = by_camera @ by_unknowns[camera]
                if self._plane is not None:
                    rows[:, -3:] = slopes.by_plane @ by_tilt
                out.append(rows / noise)
        bounded = np.abs(self.residuals(x)) >= MOST_SIGMAS
        return np.where(bounded[:, None], 0.0, np.concatenate(out))

    def covariance(self, x: Float64, jac: Float64) -> Float64:
        """[n, n] of all cameras (`Adjusted.covariance`) about a solution; `jac` [R, size] as SciPy bends it."""
        by_unknowns = block_diag(*self._by_all(x))
        cameras = int(self._starts[-1])
        spread = np.linalg.inv(jac.T @ jac)[:cameras, :cameras]
        return np.asarray(by_unknowns @ spread @ by_unknowns.T)

    def _by_all(self, x: Float64) -> list[Float64]:
        """Per camera: [6 + 4 + D, 6 + 3 + 4] of the columns of `Slopes` by its unknowns."""
        return [
            _by_unknowns(camera, x[start : start + len(sigmas)] * sigmas) * sigmas
            for camera, sigmas, start in zip(self._cameras, self._sigmas, self._starts[:-1], strict=True)
        ]


def _sigmas(camera: RigCamera) -> Float64:
    move = max(camera.sigma_m, MOVE_M / 2) if camera.sigma_m else MOVE_M
    turn = np.radians(TURN_DEG)
    lens = [FOCAL, *[CENTRE_PX * camera.width / 480] * 2]
    return np.array([*[turn] * 3, *[move] * 3, *lens, *DISTORTION], dtype=np.float64)


def _changed(camera: RigCamera, change: Float64) -> RigCamera:
    R = Rotation.from_rotvec(change[:3]).as_matrix() @ camera.T_base_cam[:3, :3]
    T = pose(R, camera.T_base_cam[:3, 3] + change[3:POSE])
    focal, cx, cy = change[POSE : POSE + LENS]
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= 1 + focal
    K[:2, 2] += [cx, cy]
    D = camera.D.copy()
    D[:4] += change[POSE + LENS :]
    return replace(camera, K=K, D=D, T_base_cam=T)


def _by_unknowns(camera: RigCamera, change: Float64) -> Float64:
    """[6 + 4 + D, 6 + 3 + 4] of the columns of `Slopes` by the change that `_changed` makes."""
    out = np.zeros((POSE + 4 + len(camera.D), len(change)))
    out[:3, :3] = turning(change[:3])
    out[3:POSE, 3:POSE] = np.eye(3)
    out[[POSE, POSE + 1], POSE] = camera.K[[0, 1], [0, 1]]
    out[[POSE + 2, POSE + 3], [POSE + 1, POSE + 2]] = 1
    lens = np.arange(len(change) - POSE - LENS)
    out[POSE + 4 + lens, POSE + LENS + lens] = 1
    return out


def _tilted(plane: Float64, change: Float64, cameras: Sequence[RigCamera]) -> Float64:
    """A plane turned by two angles (rad) about the foot of the cameras' centre, then lifted (m)."""
    m, foot = _normal(plane, change), _foot(plane, cameras)
    normal = m / np.linalg.norm(m)
    return np.array([*normal, -normal @ foot - change[2]], dtype=np.float64)


def _tilts(plane: Float64, change: Float64, cameras: Sequence[RigCamera]) -> Float64:
    """[4, 3] of `_tilted` by the change."""
    m = _normal(plane, change)
    length = np.linalg.norm(m)
    by_tilt = (np.eye(3) - np.outer(m, m) / length**2) @ np.stack(_across(plane), axis=1) / length
    out = np.zeros((4, 3))
    out[:3, :2], out[3, :2], out[3, 2] = by_tilt, -_foot(plane, cameras) @ by_tilt, -1
    return out


def _across(plane: Float64) -> list[Float64]:
    """Two unit vectors across a plane's normal and each other."""
    first = np.cross(plane[:3], [1.0, 0.0, 0.0] if abs(plane[0]) < 0.9 else [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    return [first, np.cross(plane[:3], first)]


def _normal(plane: Float64, change: Float64) -> Float64:
    """[3] a tilted plane's normal, of no certain length."""
    first, second = _across(plane)
    return np.asarray(plane[:3] + change[0] * first + change[1] * second)


def _foot(plane: Float64, cameras: Sequence[RigCamera]) -> Float64:
    """[3] the point of a plane that is nearest to the cameras' centre."""
    centre = np.mean([camera.T_base_cam[:3, 3] for camera in cameras], axis=0)
    return np.asarray(centre - plane[:3] * (plane[:3] @ centre + plane[3]))
