"""Where a lens's calibration begins: a plain lens about the middle of the image, and the boards' poses before it.

All that makes a lens out, beside its focal length, is left to bundle adjustment, whose priors keep it from what corners
leave open: eight coefficients that are free from the beginning end at hundreds that cancel out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.geometry import pose, transform
from twin_node.rig.calibrate.boards import Board, Corners
from twin_node.rig.calibrate.lenses import COEFFICIENTS, Lens, camera_matrix, project
from twin_node.rig.calibrate.pose_graph import board_pose
from twin_node.rig.errors import RigError
from twin_node.scene import Float64

PLAIN = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-9)

FISHEYE_FOCALS = np.geomspace(0.15, 2.0, 12)
"""Focal lengths that are tried of a fisheye, as shares of the image's width: one is right to an eighth. OpenCV's own
start takes one for certain, and gives good pictures up where it is wrong."""


ELSEWHERE = pose(np.eye(3), np.array([0.0, 0.0, 1.0]))
"""Where a board is taken to be of which a lens tells no place."""


@dataclass(frozen=True)
class LensStart:
    """A first guess."""

    lens: Lens
    poses: Float64
    """[V, 4, 4] board to optical frame, per view."""


def lens_start(board: Board, views: Sequence[Corners], size: tuple[int, int], model: str, source: str) -> LensStart:
    """A first guess of a lens and of where the board was in every view.

    `size`: (width, height) pixels. Raises `RigError`, which names `source`, where the views determine none.
    """
    try:
        return (_fisheye if model == "equidistant" else _pinhole)(board, views, size, model)
    except (cv2.error, ValueError) as error:
        reason = " ".join(str(getattr(error, "err", None) or error).split())
        raise RigError(
            f"{source}: expected views that determine a {model} lens, found that they do not ({reason}); "
            "take pictures of the board tilted to all sides"
        ) from error


def _pinhole(board: Board, views: Sequence[Corners], size: tuple[int, int], model: str) -> LensStart:
    """Zhang's method, PAMI 2000."""
    objects = [board.points[corners.ids].astype(np.float32)[:, None] for corners in views]
    pixels = [corners.pixels.astype(np.float32)[:, None] for corners in views]
    _, K, D, rotations, translations = cv2.calibrateCamera(
        objects, pixels, size, _middle(1.0, size), np.zeros(5), flags=PLAIN, criteria=STOP
    )
    bent = np.zeros(COEFFICIENTS[model])
    bent[:2] = np.ravel(D)[:2]
    T = np.tile(np.eye(4), (len(views), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.asarray(rotations, np.float64).reshape(-1, 3)).as_matrix()
    T[:, :3, 3] = np.asarray(translations, np.float64).reshape(-1, 3)
    return LensStart(Lens(*size, np.asarray(K, np.float64), model, bent), T)


def _fisheye(board: Board, views: Sequence[Corners], size: tuple[int, int], model: str) -> LensStart:
    """The focal length through which the boards look flattest."""
    lenses = [
        Lens(*size, _middle(share * size[0], size), model, np.zeros(COEFFICIENTS[model])) for share in FISHEYE_FOCALS
    ]
    return min((_placed(board, views, lens) for lens in lenses), key=lambda found: found.miss_px).start


@dataclass(frozen=True)
class _Placed:
    start: LensStart
    miss_px: float
    """Median over views of the mean distance of corners from where they are projected."""


def _placed(board: Board, views: Sequence[Corners], lens: Lens) -> _Placed:
    poses, misses = [], []
    for corners in views:
        points = board.points[corners.ids]
        T = board_pose(lens, points, corners.pixels)
        poses.append(ELSEWHERE if T is None else T)
        off = corners.pixels - project(lens, transform(poses[-1], points)).pixels
        misses.append(float(np.linalg.norm(off, axis=1).mean()))
    return _Placed(LensStart(lens, np.stack(poses)), float(np.median(misses)))


def _middle(focal: float, size: tuple[int, int]) -> Float64:
    """`K` [3, 3] of a lens over the middle of an image."""
    return camera_matrix(focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)
