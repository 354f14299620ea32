"""What a calibrated camera must satisfy, and the likely cause where it does not."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import inverse_pose
from twin_node.ranges import Range
from twin_node.rig.errors import RigError
from twin_node.rig.undistort import is_straight
from twin_node.rig.workspace import axes_focus, axes_spread
from twin_node.scene import Rig

DISTORTION_LENGTHS = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "equidistant": (4,)}
"""ROS distortion models and how many coefficients each takes."""

MOST_PX = 32_767
"""What OpenCV's maps can address."""

MOST_SKEW_PX = 0.5
"""Skew that moves no pixel by more than half of one is left out in silence."""

MOST_DISTORTION = 1e5
"""Largest distortion coefficient: those of rational models, above and below the line, may be large together."""

FOCALS = Range(0.02, 1000.0)
"""Focal lengths that a lens may have, in longer sides of its images: views from 176 degrees to a twentieth of one."""

MAX_DISTANCE_M = 100.0
"""No camera of a robot cell is further from the base; beyond this a translation is taken for millimetres."""

OUT_OF_SIGHT = np.radians(60)
"""A camera that looks past what the others look at by more than this does not see it: half of a wide lens's view."""

IN_SIGHT = np.radians(20)
"""A camera that looks past what the others look at by less than this has it well inside its view."""

TELLING_SPREAD = 0.03
"""Mean squared sine of the angles between optical axes and their mean (10 deg) from which they surely meet."""

LARGEST_ROUNDED = 1e9
"""Numbers below this are told to six digits behind the point."""

ROTATION_TOLERANCE = 1e-3
"""Largest deviation of R R^T from the identity: rounding to four digits passes, a scaled rotation does not."""

Float = NDArray[np.float64]


def check_rig(rig: Rig) -> None:
    """Raises `RigError` where a rig that was not read from a file is none that a file may hold."""
    for camera in rig.cameras:
        where = f"camera {camera.name}"
        _check_numbers(f"{where}: K", camera.K, (3, 3))
        _check_numbers(f"{where}: T_base_cam", camera.T_base_cam, (4, 4))
        _check_numbers(f"{where}: D", camera.D, (np.size(camera.D),))
        check_size(where, np.array([camera.width, camera.height]))
        check_intrinsics(where, camera.K, (camera.width, camera.height))
        check_pose(where, camera.T_base_cam)
        if not is_straight(camera):
            check_distortion(where, camera.distortion_model, camera.D)
    if rig.cameras:
        names = tuple(camera.name for camera in rig.cameras)
        check_facing("rig", names, np.stack([camera.T_base_cam for camera in rig.cameras]))


def _check_numbers(where: str, found: Float, shape: tuple[int, ...]) -> None:
    flat = len(shape) == 1
    wanted = f"{where}: expected finite numbers {'[n]' if flat else list(shape)}"
    if np.shape(found) != shape:
        hint = "of what OpenCV gives take `ravel()`" if flat else "check the calibration"
        raise RigError(f"{wanted}, found shape {list(np.shape(found))}; {hint}")
    if not np.isfinite(found).all():
        raise RigError(f"{wanted}, found {_text(found)}; check the calibration")


def check_size(where: str, size: Float) -> None:
    """Raises `RigError` where `size` [2] (width, height) is none of images."""
    if not ((size >= 1) & (size <= MOST_PX) & (size % 1 == 0)).all():
        raise RigError(
            f"{where}.size: expected [width, height] in whole pixels, up to {MOST_PX}, found {size.tolist()}"
        )


def check_intrinsics(where: str, K: Float, size: tuple[int, int]) -> None:
    """Raises `RigError` where `K` [3, 3] (pixels) is no pinhole matrix of an image of `size` (width, height)."""
    shape_ok = K[0, 0] > 0 and K[1, 1] > 0 and np.allclose(K[2], [0, 0, 1]) and K[1, 0] == 0
    if not shape_ok:
        hint = "transpose it" if K[2, 0] > 0 and K[2, 1] > 0 else "write the intrinsics in pixels"
        raise RigError(
            f"{where}.K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0, found {_text(K)}; {hint}"
        )
    side = max(size)
    if not all(FOCALS.holds(float(focal) / side) for focal in (K[0, 0], K[1, 1])):
        raise RigError(
            f"{where}.K: expected focal lengths from {FOCALS.least * side:g} to {FOCALS.most * side:g} px of "
            f"images {side} px long, found {K[0, 0]:g} and {K[1, 1]:g}; write the intrinsics in pixels"
        )
    if abs(K[0, 1]) > MOST_SKEW_PX:
        raise RigError(
            f"{where}.K: expected no skew (0 beside fx), found {K[0, 1]:g}: no lens model here has one; calibrate with "
            "it fixed at 0"
        )
    width, height = size
    cx, cy = float(K[0, 2]), float(K[1, 2])
    if not (0 < cx < width and 0 < cy < height):
        raise RigError(
            f"{where}.K: expected a principal point inside the image of {width}x{height}, found ({cx:g}, {cy:g}); "
            f"is K of another resolution (about {2 * cx:.0f}x{2 * cy:.0f})?"
        )


def whole_coefficients(model: str, D: Float) -> Float:
    """Distortion coefficients as the model takes them: other tools leave out zeros at the end, or write more of them.

    OpenCV, for one, gives 14 of which it was asked for 8. What is left too long or too short is for `check_distortion`.
    """
    if model not in DISTORTION_LENGTHS:
        return D
    most = max(DISTORTION_LENGTHS[model])
    known = np.trim_zeros(D, "b")
    if len(known) > most or len(D) in DISTORTION_LENGTHS[model]:
        return D
    return np.concatenate([known, np.zeros(most - len(known))])


def check_distortion(where: str, model: str, coefficients: Float) -> None:
    """Raises `RigError` for an unknown model, and for coefficients of a wrong number or beyond any lens's."""
    if model not in DISTORTION_LENGTHS:
        raise RigError(f"{where}.distortion.model: expected one of {', '.join(DISTORTION_LENGTHS)}, found {model!r}")
    lengths = DISTORTION_LENGTHS[model]
    if len(coefficients) not in lengths:
        expected = " or ".join(map(str, lengths))
        raise RigError(
            f"{where}.distortion.coefficients: expected {expected} numbers for {model}, found {len(coefficients)}"
        )
    if (np.abs(coefficients) > MOST_DISTORTION).any():
        raise RigError(
            f"{where}.distortion.coefficients: expected numbers up to {MOST_DISTORTION:g}, found "
            f"{_text(coefficients)}: no lens has such; calibrate it anew"
        )


def check_pose(where: str, T: Float) -> None:
    """Raises `RigError` where `T` [4, 4] is no rigid motion in metres."""
    if not np.allclose(T[3], [0, 0, 0, 1], atol=1e-9):
        transposed = np.allclose(T[:3, 3], 0) and T[3, 3] == 1
        hint = "transpose it" if transposed else "the last row belongs to a rigid motion"
        raise RigError(f"{where}.T_base_cam: expected the last row [0, 0, 0, 1], found {_text(T[3])}; {hint}")
    R = T[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        deviation = float(np.abs(R @ R.T - np.eye(3)).max())
    if not deviation <= ROTATION_TOLERANCE:
        raise RigError(
            f"{where}.T_base_cam: expected orthonormal rotation columns, found R R^T off the identity by "
            f"{deviation:.3g}; {_rotation_hint(R)}"
        )
    if np.linalg.det(R) < 0:
        raise RigError(
            f"{where}.T_base_cam: expected a rotation of determinant 1, found -1; "
            "one axis is mirrored (left-handed coordinates): flip its column"
        )
    distance = math.hypot(*T[:3, 3])
    if distance > MAX_DISTANCE_M:
        raise RigError(
            f"{where}.T_base_cam: expected a translation in metres, found {_text(T[:3, 3])}, "
            f"{distance:.6g} m from the base; if it is in millimetres divide it by 1000 (in centimetres by 100)"
        )


def check_facing(where: str, names: tuple[str, ...], poses: Float) -> None:
    """Raises `RigError` where cameras with poses [N, 4, 4] see nothing together unless read in another convention.

    Cameras of a rig look at one volume: the point nearest to all optical axes lies in front of them. Where it lies out
    of sight, and undoing a customary mistake (world-to-camera poses, OpenGL axes, transposed rotations) puts it into
    the middle of every image, that is named. Axes nearer to parallel than `TELLING_SPREAD` tell nothing.
    """
    if axes_spread(poses) < TELLING_SPREAD or aims_off(poses) < OUT_OF_SIGHT:
        return
    transposed = poses.copy()
    transposed[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
    readings = {
        "the rotations are transposed: transpose each and keep its translation": transposed,
        "T_base_cam holds base-to-camera poses (extrinsics R, t): invert them": inverse_pose(poses),
        "the cameras have OpenGL axes (z backward): negate columns 2 and 3 of each": poses * [1.0, -1.0, -1.0, 1.0],
    }
    cause = min(readings, key=lambda reading: aims_off(readings[reading]))
    if aims_off(readings[cause]) < IN_SIGHT:
        raise RigError(
            f"{where}: cameras {', '.join(names)}: expected optical axes that meet in front of the cameras, "
            f"found none that do; {cause}"
        )


def aims_off(poses: Float) -> float:
    """Largest angle (rad) between an optical axis of poses [N, 4, 4] and the way to the point nearest to all axes.

    Of a camera that stands at that point itself: a right angle.
    """
    to_focus = axes_focus(poses) - poses[:, :3, 3]
    cosines = (to_focus * poses[:, :3, 2]).sum(1) / np.maximum(np.linalg.norm(to_focus, axis=1), 1e-12)
    return float(np.arccos(np.clip(cosines, -1, 1)).max())


@np.errstate(over="ignore", invalid="ignore")
def _rotation_hint(R: Float) -> str:
    scales = np.linalg.norm(R, axis=0)
    if np.allclose(scales, scales[0], rtol=1e-3) and np.allclose(R.T @ R, np.eye(3) * scales[0] ** 2, atol=1e-3):
        return f"it is a rotation scaled by {scales[0]:.4g}: divide it by that"
    return "a number may be mistyped or too much rounded"


def _text(a: Float) -> str:
    """Numbers for a user; those that would leave floating point if they were rounded stay as they are."""
    return str(
        np.where(np.abs(a) < LARGEST_ROUNDED, np.round(np.clip(a, -LARGEST_ROUNDED, LARGEST_ROUNDED), 6), a).tolist()
    )
