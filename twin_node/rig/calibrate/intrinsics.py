"""Calibrates one lens from pictures of a board: a plain lens first, then bundle adjustment of all that it has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import rotation_from_quat, transform
from twin_node.rig.calibrate.board_shape import BoardShape, board_shape
from twin_node.rig.calibrate.boards import Board, Corners
from twin_node.rig.calibrate.bundle import BundleOptions, BundleResult, BundleState, Sighting
from twin_node.rig.calibrate.bundle_solver import solve_bundle, with_board_that_pays
from twin_node.rig.calibrate.course import still_course
from twin_node.rig.calibrate.lens_start import LensStart, lens_start
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

MOST_OPEN = 0.1
"""1 sigma of the focal length, as a share of it, beyond which the views leave it open."""


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
    board: BoardShape
    """What the pictures show of the board's shape."""

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

    The board's corners are refined with it where the views say clearly that the board is bowed, bent or stretched.
    `size`: (width, height) pixels; `source`: named in errors. Raises `RigError` for an unknown model, where too few
    views are left, and where they leave the focal length open: boards that all face the camera look the same from
    far away through a long lens.
    """
    if model not in COEFFICIENTS:
        raise RigError(f"distortion model: expected one of {', '.join(COEFFICIENTS)}, found {model!r}")
    unlike, twice = _unlike(views)
    used, dropped = _usable(board, [_flat(board, view, size) for view in unlike], "too few corners that lie on a plane")
    dropped += twice
    for _ in range(START_ROUNDS):
        if len(used) < MIN_VIEWS:
            raise RigError(
                f"{source}: expected at least {MIN_VIEWS} views of the board ({board}), found {len(used)} "
                f"among {len(views)} with a board; check its columns, rows and dictionary, whether it is inverted or "
                "legacy and the images are mirrored, or take more pictures"
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
    _check_told(calibration, source)
    return calibration


def _check_told(calibration: LensCalibration, source: str) -> None:
    lens, sigma = calibration.lens, float(calibration.sigmas[0])
    objection = view_objection(lens)
    if objection is None and sigma > MOST_OPEN * lens.K[0, 0]:
        objection = f"expected a focal length told to {100 * MOST_OPEN:g} %, found {lens.K[0, 0]:.0f} +- {sigma:.0f} px"
    if objection is not None:
        raise RigError(
            f"{source}: {objection}: the views leave it open; take pictures of the board tilted to all sides"
        )


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
    board: Board, views: Sequence[BoardView], start: LensStart, dropped: Sequence[DroppedView]
) -> LensCalibration:
    """The lens by bundle adjustment, which also tells how sure it is, over a flat board or one that is not."""
    sightings = [Sighting(0, number, view.corners) for number, view in enumerate(views)]
    bundle = _bundle(board, views, start)
    bundle = with_board_that_pays(bundle, sightings, BundleOptions())
    return LensCalibration(
        bundle.state.lenses[0],
        np.sqrt(np.diag(bundle.covariance)[bundle.layout.lens(0)]),
        tuple(BoardView(views[s.board].name, s.corners) for s in bundle.sightings),
        bundle.residuals,
        (*dropped, *(DroppedView(views[s.board].name, "fits no other view") for s in bundle.left_out)),
        board_shape(board.points, bundle.state.points),
    )


def _unlike(views: Sequence[BoardView]) -> tuple[list[BoardView], list[DroppedView]]:
    """The views without copies of others: a copy would count as a second witness."""
    first: dict[bytes, str] = {}
    kept, dropped = [], []
    for view in views:
        told = view.corners.ids.tobytes() + view.corners.pixels.tobytes()
        if told in first:
            dropped.append(DroppedView(view.name, f"the same picture as {first[told]}"))
        else:
            first[told] = view.name
            kept.append(view)
    return kept, dropped


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
    return replace(view, corners=view.corners.chosen(kept))


def _usable(board: Board, views: Sequence[BoardView], reason: str) -> tuple[list[BoardView], list[DroppedView]]:
    """The views that tell the board's pose, and the others, left out for a reason."""
    used = [view for view in views if usable(board, view.corners)]
    return used, [DroppedView(view.name, reason) for view in views if not usable(board, view.corners)]


def _solve(board: Board, views: Sequence[BoardView], size: tuple[int, int], model: str, source: str) -> LensStart:
    """The lens and the poses that fit a flat board, some of whose corners may be wrong."""
    start = lens_start(board, [view.corners for view in views], size, model, source)
    state = _bundle(board, views, start).state
    T = np.tile(np.eye(4), (len(views), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotation_from_quat(state.course.quats), state.course.positions
    return LensStart(state.lenses[0], T)


def _bundle(board: Board, views: Sequence[BoardView], start: LensStart) -> BundleResult:
    sightings = [Sighting(0, number, view.corners) for number, view in enumerate(views)]
    course = still_course(start.poses)
    state = BundleState(
        np.eye(4)[None], course, (start.lens,), board.points, np.zeros((1, 2)), np.zeros(1), np.zeros(len(views))
    )
    return solve_bundle(state, sightings, BundleOptions())


def _residuals(board: Board, views: Sequence[BoardView], solution: LensStart) -> list[Float64]:
    return [
        view.corners.pixels - project(solution.lens, transform(T, board.points[view.corners.ids])).pixels
        for view, T in zip(views, solution.poses, strict=True)
    ]
