"""Calibrates one lens from pictures of a board (Zhang's method, `cv2.calibrateCamera` and `cv2.fisheye.calibrate`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin_node.geometry import transform
from twin_node.rig.calibrate.boards import Board, Corners
from twin_node.rig.calibrate.bundle import BundleOptions, BundleState, Sighting
from twin_node.rig.calibrate.bundle_solver import board_pays, solve_bundle
from twin_node.rig.calibrate.course import still_course
from twin_node.rig.calibrate.lenses import COEFFICIENTS, Lens, project
from twin_node.rig.calibrate.objections import view_objection
from twin_node.rig.errors import RigError
from twin_node.scene import Bool, Float64

MIN_VIEWS = 3
"""Fewest views of a plane that determine a lens (Zhang, PAMI 2000, section 3.1)."""

MIN_CORNERS = 6
"""Fewest corners of a view that say more than its six numbers of pose need."""

MIN_SPREAD = 0.05
"""Narrowest extent of a view's corners as a share of their longest: below it they lie on a line and tell no pose."""

BENT_SHARE = 0.01
"""Share of an image's width by which the strongest lenses bend the picture of a flat board; corners further than this
from every flat board are misread."""

OUTLIER_FACTOR = 4.0
"""A corner further off than so many times the median of all is left out of the first solution."""

OUTLIER_FLOOR_PX = 1.0
"""No corner better than this is left out of the first solution, however good the others are."""

MOST = 0.5
"""Share of a view's corners that must fit, else the board was misread."""

START_ROUNDS = 4
"""First solutions, each without the corners that fitted the one before badly."""

COVERAGE_CELLS = (6, 8)
"""Rows and columns of cells that coverage is counted in."""

STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-9)


@dataclass(frozen=True)
class BoardView:
    """A board as one image shows it."""

    name: str
    """Of the image, for messages."""
    corners: Corners


@dataclass(frozen=True)
class DroppedView:
    """A view that the calibration does without."""

    name: str
    reason: str


@dataclass(frozen=True)
class LensCalibration:
    """A lens, and how well the pictures determine it."""

    lens: Lens
    sigmas: Float64
    """[4 + D] 1 sigma of `lens.parameters`."""
    views: tuple[BoardView, ...]
    """The views that were used."""
    residuals: tuple[Float64, ...]
    """Per view: [N, 2] found minus projected, pixels."""
    dropped: tuple[DroppedView, ...]

    @property
    def rms_px(self) -> float:
        """Root mean square distance between found and projected corners, pixels."""
        return rms(self.residuals)

    @property
    def coverage(self) -> NDArray[np.int64]:
        """[6, 8] corners in each cell of the image."""
        return coverage(self.views, (self.lens.width, self.lens.height))


def calibrate_lens(
    board: Board,
    views: Sequence[BoardView],
    size: tuple[int, int],
    model: str = "plumb_bob",
    source: str = "images",
) -> LensCalibration:
    """The lens that explains the views best; views that do not fit are dropped and named.

    The board's corners are refined with it where the views say clearly that the board is not flat or stretched.
    `size`: (width, height) pixels; `source`: named in errors. Raises `RigError` for an unknown model, where too few
    views are left, and where they leave the focal length open: boards that all face the camera look the same from
    far away through a long lens.
    """
    if model not in COEFFICIENTS:
        raise RigError(f"distortion model: expected one of {', '.join(COEFFICIENTS)}, found {model!r}")
    used, dropped = _usable(board, [_flat(board, view, size) for view in views], "too few corners that lie on a plane")
    for _ in range(START_ROUNDS):
        if len(used) < MIN_VIEWS:
            raise RigError(
                f"{source}: expected at least {MIN_VIEWS} views of the board ({board}), found {len(used)} "
                f"among {len(views)} with a board; check the board's size and take more pictures"
            )
        solution = _solve(board, used, size, model, source)
        kept = _fitting(_residuals(board, used, solution))
        if all(own.all() for own in kept):
            break
        used, more = _usable(board, [_thinned(v, own) for v, own in zip(used, kept, strict=True)], "fits no other view")
        dropped += more
    else:
        solution = _solve(board, used, size, model, source)
    calibration = _refined(board, used, solution, dropped)
    if (objection := view_objection(calibration.lens)) is not None:
        raise RigError(
            f"{source}: {objection}: the views leave it open; take pictures of the board tilted to all sides"
        )
    return calibration


def usable(board: Board, corners: Corners) -> bool:
    """Whether corners are enough, and wide enough apart, to tell the pose of their board."""
    if len(corners) < MIN_CORNERS:
        return False
    points = board.points[corners.ids, :2]
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extent[1] > MIN_SPREAD * extent[0])


def rms(residuals: Sequence[Float64]) -> float:
    """Root mean square length of residuals [N, 2] of several views, pixels."""
    return float(np.sqrt(np.mean((np.concatenate(residuals) ** 2).sum(axis=1))))


def coverage(views: Sequence[BoardView], size: tuple[int, int]) -> NDArray[np.int64]:
    """[6, 8] corners of the views in each cell of an image of `size` (width, height)."""
    pixels = np.concatenate([view.corners.pixels for view in views])
    rows, columns = COVERAGE_CELLS
    counts, *_ = np.histogram2d(
        pixels[:, 1], pixels[:, 0], bins=(rows, columns), range=((-0.5, size[1] - 0.5), (-0.5, size[0] - 0.5))
    )
    return np.asarray(counts, dtype=np.int64)


def _refined(
    board: Board, views: Sequence[BoardView], start: _Solution, dropped: Sequence[DroppedView]
) -> LensCalibration:
    """The lens by bundle adjustment, which also tells how sure it is, over a flat board or one that is not."""
    sightings = [Sighting(0, number, view.corners) for number, view in enumerate(views)]
    course = still_course(start.poses)
    state = BundleState(np.eye(4)[None], course, (start.lens,), board.points, np.zeros((1, 2)))
    bundle = solve_bundle(state, sightings, BundleOptions())
    bent = solve_bundle(bundle.state, sightings, BundleOptions(board=True))
    bundle = bent if board_pays(bundle, bent) else bundle
    return LensCalibration(
        bundle.state.lenses[0],
        np.sqrt(np.diag(bundle.covariance)[bundle.layout.lens(0)]),
        tuple(BoardView(views[s.board].name, s.corners) for s in bundle.sightings),
        bundle.residuals,
        (*dropped, *(DroppedView(views[s.board].name, "fits no other view") for s in bundle.left_out)),
    )


@dataclass(frozen=True)
class _Solution:
    lens: Lens
    poses: Float64
    """[V, 4, 4] board to optical frame, per view."""


def _flat(board: Board, view: BoardView, size: tuple[int, int]) -> BoardView:
    """The view without corners that no flat board, seen through any lens, has where they are (RANSAC)."""
    if len(view.corners) < MIN_CORNERS:
        return view
    _, mask = cv2.findHomography(
        board.points[view.corners.ids, :2], view.corners.pixels, cv2.RANSAC, BENT_SHARE * size[0]
    )
    return _thinned(view, np.zeros(len(view.corners), bool) if mask is None else np.asarray(mask).ravel() > 0)


def _fitting(residuals: Sequence[Float64]) -> list[Bool]:
    """Per view: [N] which corners fit a solution."""
    lengths = [np.linalg.norm(residual, axis=1) for residual in residuals]
    limit = max(OUTLIER_FACTOR * float(np.median(np.concatenate(lengths))), OUTLIER_FLOOR_PX)
    return [own < limit if (own < limit).mean() >= MOST else np.zeros(len(own), bool) for own in lengths]


def _thinned(view: BoardView, kept: Bool) -> BoardView:
    return replace(view, corners=Corners(view.corners.ids[kept], view.corners.pixels[kept]))


def _usable(board: Board, views: Sequence[BoardView], reason: str) -> tuple[list[BoardView], list[DroppedView]]:
    """The views that tell the board's pose, and the others, left out for a reason."""
    used = [view for view in views if usable(board, view.corners)]
    return used, [DroppedView(view.name, reason) for view in views if not usable(board, view.corners)]


def _solve(board: Board, views: Sequence[BoardView], size: tuple[int, int], model: str, source: str) -> _Solution:
    solve = _solve_fisheye if model == "equidistant" else _solve_pinhole
    try:
        return solve(board, views, size, model)
    except cv2.error as error:
        reason = " ".join(str(error.err or error).split())
        raise RigError(
            f"{source}: expected views that determine a {model} lens, found that they do not ({reason}); "
            "take pictures of the board tilted to all sides"
        ) from error


def _solve_pinhole(board: Board, views: Sequence[BoardView], size: tuple[int, int], model: str) -> _Solution:
    objects = [board.points[view.corners.ids].astype(np.float32)[:, None] for view in views]
    pixels = [view.corners.pixels.astype(np.float32)[:, None] for view in views]
    flags = cv2.CALIB_RATIONAL_MODEL if model == "rational_polynomial" else 0
    _, K, D, rotations, translations = cv2.calibrateCamera(
        objects, pixels, size, np.eye(3), np.zeros(5), flags=flags, criteria=STOP
    )
    count = COEFFICIENTS[model]
    lens = Lens(*size, np.asarray(K, np.float64), model, np.asarray(D, np.float64).ravel()[:count])
    return _Solution(lens, _poses(rotations, translations))


def _solve_fisheye(board: Board, views: Sequence[BoardView], size: tuple[int, int], model: str) -> _Solution:
    objects = [board.points[view.corners.ids][None] for view in views]
    pixels = [view.corners.pixels[None] for view in views]
    flags = cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC | cv2.fisheye.CALIB_FIX_SKEW
    _, K, D, rotations, translations = cv2.fisheye.calibrate(
        objects, pixels, size, np.eye(3), np.zeros(4), flags=flags, criteria=STOP
    )
    lens = Lens(*size, np.asarray(K, np.float64), model, np.asarray(D, np.float64).ravel())
    return _Solution(lens, _poses(rotations, translations))


def _poses(rotations: Sequence[object], translations: Sequence[object]) -> Float64:
    T = np.tile(np.eye(4), (len(rotations), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.asarray(rotations, np.float64).reshape(-1, 3)).as_matrix()
    T[:, :3, 3] = np.asarray(translations, np.float64).reshape(-1, 3)
    return T


def _residuals(board: Board, views: Sequence[BoardView], solution: _Solution) -> list[Float64]:
    return [
        view.corners.pixels - project(solution.lens, transform(T, board.points[view.corners.ids])).pixels
        for view, T in zip(views, solution.poses, strict=True)
    ]
