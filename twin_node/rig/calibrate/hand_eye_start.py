"""Closed-form hand-eye calibration, and how the points of a symmetrical target are numbered in each view."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose, pose, transform
from twin_node.rig.calibrate.lenses import pixel_rays, raw_pixels
from twin_node.rig.errors import RigError
from twin_node.scene import Bool, Float64, RigCamera

AX_XB = (cv2.CALIB_HAND_EYE_PARK, cv2.CALIB_HAND_EYE_TSAI, cv2.CALIB_HAND_EYE_DANIILIDIS)
ROBOT_WORLD = (cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH, cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI)
SAME_M, SAME_RAD = 1e-4, np.radians(0.01)
"""A robot that has moved by less has not: arms come back to a stop by less than this."""
DRAWN, DRAWS = 5, 24
"""Stops of a draw, and draws: where two of twelve stops are wrong, all draws hold one once in 10,000 sessions."""
NO_DOUBT = np.radians(5)
"""A numbering is taken for certain where the next best fits the turn of the robot worse by this much."""


@dataclass(frozen=True)
class Loop:
    """The unknown poses of `T_camera_target = X^-1 G Y`."""

    X: Float64
    """[4, 4] pose of the camera in what carries it."""
    Y: Float64
    """[4, 4] pose of the target in what carries it."""


@dataclass(frozen=True)
class Stops:
    """What the robot and the camera say at N stops, of a target of P points."""

    carried: Float64
    """[N, 4, 4] the known G: what carries the target as seen from what carries the camera."""
    pixels: Float64
    """[N, P, 2] raw pixels of the target's points, OpenCV convention; NaN for those not seen."""
    carried_off: Float64
    """[J, N, 4, 4] G were a joint of the arm off by 1 sigma, one after the other; J = 0 where no joints tell it."""

    def chosen(self, rows: Bool) -> Stops:
        """The stops under this mask [N]."""
        return Stops(self.carried[rows], self.pixels[rows], self.carried_off[:, rows])

    @property
    def places(self) -> NDArray[np.int64]:
        """[N] number of the place at which the robot stood: pictures taken without a move between share one."""
        out, firsts = np.zeros(len(self.carried), np.int64), [self.carried[0]]
        for i, pose_here in enumerate(self.carried):
            moves = inverse_pose(np.stack(firsts)) @ pose_here
            near = (np.linalg.norm(moves[:, :3, 3], axis=1) < SAME_M) & (_angles(moves[:, :3, :3]) < SAME_RAD)
            if not near.any():
                firsts.append(pose_here)
            out[i] = int(near.argmax()) if near.any() else len(firsts) - 1
        return out


def offsets(camera: RigCamera, target: Float64, stops: Stops, loop: Loop) -> Float64:
    """[N, P, 2] pixels from where the target [P, 3] (m) is seen to where the loop puts it; NaN where it is not seen."""
    points = seen_points(target, stops, loop)
    out: Float64 = raw_pixels(camera, points.reshape(-1, 3)).reshape(stops.pixels.shape) - stops.pixels
    return out


def seen_points(target: Float64, stops: Stops, loop: Loop) -> Float64:
    """[N, P, 3] places of the target's points [P, 3] (m) in the optical frame at every stop, as the loop puts them."""
    poses = inverse_pose(loop.X) @ stops.carried @ loop.Y
    points: Float64 = target @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3]
    return points


def numbered_alike(camera: RigCamera, target: Float64, stops: Stops) -> Stops:
    """The stops with every view's pixels numbered from the same corner of a target that looks alike from several.

    First the views whose turn since the first view leaves no doubt, then all by the calibration that these give.
    """
    turns = target_symmetries(target)
    if len(turns) == 1:
        return stops
    candidates = _target_poses(camera, target, stops)[:, None] @ turns  # [N, S, 4, 4]
    turned = _angles(stops.carried[:1, :3, :3].swapaxes(1, 2) @ stops.carried[:, :3, :3])
    looked = _angles(candidates[:1, :1, :3, :3].swapaxes(2, 3) @ candidates[..., :3, :3])
    off = np.abs(looked - turned[:, None])
    ranked = np.sort(off, axis=1)
    rows = np.flatnonzero(ranked[:, 1] - ranked[:, 0] > NO_DOUBT)
    for _ in range(2):
        if len(rows) < 3:
            break
        poses = candidates[rows, off.argmin(1)[rows]]
        pixels = _reordered(camera, target, stops, poses, rows)
        loop = closed_form(camera, target, Stops(stops.carried[rows], pixels, stops.carried_off[:, rows]))
        expected = inverse_pose(loop.X) @ stops.carried @ loop.Y
        off = _angles(expected[:, None, :3, :3].swapaxes(2, 3) @ candidates[..., :3, :3])
        rows = np.arange(len(off))
    rows = np.arange(len(off))
    return replace(stops, pixels=_reordered(camera, target, stops, candidates[rows, off.argmin(1)], rows))


def target_symmetries(target: Float64) -> Float64:
    """[S, 4, 4] turns by quarters about the axis through the centre of a flat target [P, 3] that leave it as it is."""
    centre = (target.min(0) + target.max(0)) / 2
    kept = []
    for quarter in range(4):
        R = Rotation.from_euler("z", 90 * quarter, degrees=True).as_matrix()
        M = pose(R, centre - R @ centre)
        distance = np.linalg.norm(transform(M, target)[:, None] - target[None], axis=2)
        if distance.min(1).max() < 1e-6 * np.ptp(target):
            kept.append(M)
    return np.stack(kept)


def closed_form(camera: RigCamera, target: Float64, stops: Stops) -> Loop:
    """The solution that reprojects best among OpenCV's AX = XB and robot-world methods, of all stops and of some.

    Neither method sheds a stop whose pose is wrong; of a few stops drawn some have none.
    Raises `RigError` where none of them finds one.
    """
    seen, loops = _target_poses(camera, target, stops), []
    for rows in _groups(len(seen)):
        for solve, methods in ((_from_motions, AX_XB), (_from_poses, ROBOT_WORLD)):
            for method in methods if len(rows) == len(seen) else methods[:1]:
                with contextlib.suppress(cv2.error, ValueError):  # poses that contradict the pictures: no rotation
                    loop = solve(stops.carried[rows], seen[rows], method)
                    if np.isfinite(loop.X).all() and np.isfinite(loop.Y).all():
                        loops.append(loop)
    if not loops:
        raise RigError("hand-eye: expected motions that tell the camera's pose, found none that do; add stops")
    return min(loops, key=lambda loop: float(np.nanmedian(np.abs(offsets(camera, target, stops, loop)))))


def _groups(count: int) -> list[NDArray[np.intp]]:
    """Rows of stops to solve from: all, then draws (the same every time) of a few."""
    everything = np.arange(count)
    if count <= DRAWN:
        return [everything]
    rng = np.random.default_rng(0)
    return [everything, *(np.sort(rng.choice(count, DRAWN, replace=False)) for _ in range(DRAWS))]


def _from_motions(carried: Float64, seen: Float64, method: int) -> Loop:
    """From the robot's moves between stops: AX = XB."""
    back = inverse_pose(carried)
    R, t = cv2.calibrateHandEye(
        list(back[:, :3, :3]), list(back[:, :3, 3]), list(seen[:, :3, :3]), list(seen[:, :3, 3]), method=method
    )
    X = pose(_rotation(R), np.ravel(t))
    Ys = back @ X @ seen
    return Loop(X, pose(Rotation.from_matrix(Ys[:, :3, :3]).mean().as_matrix(), Ys[:, :3, 3].mean(0)))


def _from_poses(carried: Float64, seen: Float64, method: int) -> Loop:
    """From the robot's poses at the stops: robot-world."""
    Rw, tw, Rg, tg = cv2.calibrateRobotWorldHandEye(
        list(seen[:, :3, :3]), list(seen[:, :3, 3]), list(carried[:, :3, :3]), list(carried[:, :3, 3]), method=method
    )
    return Loop(inverse_pose(pose(_rotation(Rg), np.ravel(tg))), inverse_pose(pose(_rotation(Rw), np.ravel(tw))))


def _rotation(R: object) -> Float64:
    """[3, 3] as found, if it is one. Raises `ValueError` where it is none."""
    found = np.asarray(R, np.float64)
    if not np.isfinite(found).all():
        raise ValueError("no rotation was found")
    return np.asarray(Rotation.from_matrix(found).as_matrix())


def _target_poses(camera: RigCamera, target: Float64, stops: Stops) -> Float64:
    """[N, 4, 4] `T_camera_target` of every stop from its own view."""
    out = []
    for pixels in stops.pixels:
        seen = np.isfinite(pixels).all(1)
        _, rvec, tvec = cv2.solvePnP(target[seen], pixel_rays(camera, pixels[seen]), np.eye(3), np.zeros(4))
        out.append(pose(Rotation.from_rotvec(rvec.ravel()).as_matrix(), np.asarray(tvec, np.float64).ravel()))
    return np.stack(out)


def _reordered(camera: RigCamera, target: Float64, stops: Stops, poses: Float64, rows: NDArray[np.intp]) -> Float64:
    """[n, P, 2] pixels of the stops `rows` in the order that the target's points have under `poses` [n, 4, 4]."""
    out = []
    for pixels, T in zip(stops.pixels[rows], poses, strict=True):
        if not np.isfinite(pixels).all():
            raise RigError(
                "hand-eye: expected all points of a target that looks alike from several sides in every view"
            )
        distance = np.linalg.norm(raw_pixels(camera, transform(T, target))[:, None] - pixels[None], axis=2)
        order = distance.argmin(1)
        out.append(pixels[order] if len(set(order)) == len(order) else pixels)
    return np.stack(out)


def _angles(rotations: Float64) -> Float64:
    """Angle (rad) of rotation matrices [..., 3, 3]."""
    out: Float64 = np.arccos(np.clip((np.trace(rotations, axis1=-2, axis2=-1) - 1) / 2, -1, 1))
    return out
