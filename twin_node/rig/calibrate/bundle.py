"""Bundle adjustment of a rig over a moving board (Triggs et al., Bundle Adjustment: A Modern Synthesis, 1999).

Unknowns are the cameras' poses, the board's pose in every set of images and, as options, the lenses and the places of
the board's corners. SciPy solves; the first camera is the origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import LinearOperator

from twin_node.rig.calibrate.boards import Corners
from twin_node.rig.calibrate.lenses import Lens, project_points
from twin_node.scene import Float64

BOARD_TOLERANCE = 0.01
"""1 sigma of a corner's place as a share of the distance between corners, where the board is refined: at first; from
the second round on what was measured. Paper bends and printers stretch, but no print is off by several of these."""

BOARD_TOLERANCE_FLOOR = 1e-4
"""No print is better than this share of the distance between corners."""

CLOCK_SIGMA = 0.1
"""1 sigma of a camera's clock offset, s: what a frame may wait in drivers and buffers (webcams: up to a few frames)."""

ROBUST_SIGMAS = 2.0
"""Residuals beyond so many sigma count linearly (soft L1): motion blur and false corners lose their pull."""

ROUNDS = 3
"""Solutions with noise levels estimated anew from the residuals of the one before; the third moves nothing."""

INTERPOLATED_VARIANCE = 0.87
"""Variance of a corner interpolated by a cubic spline over that of the found ones, on average over the time between two
images: what is missing comes back as correlation between neighbouring sets, which the covariance must not ignore."""

NOISE_FLOOR_PX = 0.02
"""No corner is better than this, so that synthetic images do not divide by zero."""

MAX_EVALUATIONS = 30
"""A start from the graph converges in about ten."""


@dataclass(frozen=True)
class Sighting:
    """The board as one camera saw it in one set of images."""

    camera: int
    board: int
    """Number of the set: all sightings of one share the board's pose."""
    corners: Corners
    """As they would be at the set's time if the camera's clock were right."""
    velocities: Float64 | None = None
    """[N, 2] of the corners, pixels per second; None where the board stands still or images are taken at once."""
    jitter_px: float = 0.0
    """1 sigma of what the corners are off by because their stamps jitter and they move."""


@dataclass(frozen=True)
class BundleState:
    """What bundle adjustment estimates."""

    cameras: Float64
    """[C, 6] rotation vector and translation (m) that map the rig's frame to each optical frame; the first is fixed."""
    boards: Float64
    """[S, 6] the same, from the board's frame to the rig's, per set."""
    lenses: tuple[Lens, ...]
    points: Float64
    """[P, 3] the board's corners, m."""
    clocks: Float64
    """[C] seconds to add to each camera's stamps; the first is fixed."""


@dataclass(frozen=True)
class BundleOptions:
    """What is free."""

    lenses: bool = True
    """Focal lengths, principal points and distortion."""
    board: bool = True
    """The places of the board's corners, held by how far off boards are."""
    clocks: bool = True
    """Clock offsets, of cameras that saw the board move."""


@dataclass(frozen=True)
class BundleResult:
    """The estimate, what it leaves over and how sure it is."""

    state: BundleState
    residuals: tuple[Float64, ...]
    """Per sighting: [N, 2] found minus projected, pixels."""
    noise_px: Float64
    """[C] 1 sigma of each camera's corners, pixels."""
    covariance: Float64
    """[n, n] of the unknowns, `Layout` says in which order."""
    layout: Layout


@dataclass(frozen=True)
class Layout:
    """Where each unknown stands in the vector of unknowns."""

    cameras: int
    boards: int
    lens_sizes: tuple[int, ...]
    """Parameters of each lens; empty where lenses are fixed."""
    points: int
    """Corners of the board that are free, 0 where it is fixed."""
    clocks: int
    """Free clock offsets: one less than cameras, or 0."""

    def camera(self, i: int) -> slice:
        """Pose of camera i; empty for the first."""
        return slice(6 * max(i - 1, 0), 6 * i)

    def board(self, s: int) -> slice:
        """Pose of the board in set s."""
        start = 6 * (self.cameras - 1 + s)
        return slice(start, start + 6)

    def lens(self, i: int) -> slice:
        """Parameters of lens i; empty where lenses are fixed."""
        start = 6 * (self.cameras - 1 + self.boards) + sum(self.lens_sizes[:i])
        return slice(start, start + (self.lens_sizes[i] if self.lens_sizes else 0))

    @property
    def corners(self) -> slice:
        """All of the board's corners."""
        start = 6 * (self.cameras - 1 + self.boards) + sum(self.lens_sizes)
        return slice(start, start + 3 * self.points)

    @property
    def clock_offsets(self) -> slice:
        """Clock offsets of all cameras but the first."""
        return slice(self.corners.stop, self.corners.stop + self.clocks)


class BundleProblem:
    """Residuals and their Jacobian; both in units of each camera's noise."""

    def __init__(self, start: BundleState, sightings: Sequence[Sighting], options: BundleOptions) -> None:
        self._start = start
        self._sightings = sightings
        lens_sizes = tuple(len(lens.parameters) for lens in start.lenses) if options.lenses else ()
        points = len(start.points) if options.board else 0
        moves = any(sighting.velocities is not None for sighting in sightings)
        clocks = len(start.cameras) - 1 if options.clocks and moves else 0
        self.layout = Layout(len(start.cameras), len(start.boards), lens_sizes, points, clocks)
        self._step = _step(start.points)
        self._tolerance = BOARD_TOLERANCE * self._step

    def measure_board(self, state: BundleState) -> None:
        """Sets what the board's corners may be off by to what they are off by."""
        displacement = float(np.sqrt(np.mean((state.points - self._start.points) ** 2)))
        self._tolerance = max(displacement, BOARD_TOLERANCE_FLOOR * self._step)

    def pack(self, state: BundleState) -> Float64:
        """The vector of unknowns of a state."""
        parts = [state.cameras[1:].ravel(), state.boards.ravel()]
        if self.layout.lens_sizes:
            parts += [lens.parameters for lens in state.lenses]
        if self.layout.points:
            parts.append(state.points.ravel())
        if self.layout.clocks:
            parts.append(state.clocks[1:])
        return np.concatenate(parts)

    def unpack(self, x: Float64) -> BundleState:
        """The state of a vector of unknowns."""
        layout, start = self.layout, self._start
        cameras = np.concatenate([start.cameras[:1], x[: 6 * (layout.cameras - 1)].reshape(-1, 6)])
        boards = x[layout.board(0).start : layout.board(layout.boards - 1).stop].reshape(-1, 6)
        lenses, points, clocks = start.lenses, start.points, start.clocks
        if layout.lens_sizes:
            lenses = tuple(lens.with_parameters(x[layout.lens(i)]) for i, lens in enumerate(lenses))
        if layout.points:
            points = x[layout.corners].reshape(-1, 3)
        if layout.clocks:
            clocks = np.concatenate([clocks[:1], x[layout.clock_offsets]])
        return BundleState(cameras, boards, lenses, points, clocks)

    def residuals(self, state: BundleState) -> tuple[Float64, ...]:
        """Per sighting: [N, 2] found minus projected, pixels."""
        out = []
        for sighting in self._sightings:
            lens, pose = state.lenses[sighting.camera], _seen(state, sighting)
            points = state.points[sighting.corners.ids]
            found = sighting.corners.pixels
            if sighting.velocities is not None:
                late = state.clocks[sighting.camera] - self._start.clocks[sighting.camera]
                found = found - late * sighting.velocities
            out.append(found - project_points(lens, pose.rotation, pose.translation, points).pixels)
        return tuple(out)

    def weighted_residuals(self, x: Float64, noise_px: Float64) -> Float64:
        """[m] residuals over the camera's noise, then lenses and corners over what they may be off by."""
        state = self.unpack(x)
        parts = [
            (residual / np.hypot(noise_px[sighting.camera], sighting.jitter_px)).ravel()
            for sighting, residual in zip(self._sightings, self.residuals(state), strict=True)
        ]
        if self.layout.lens_sizes:
            parts += [lens.priors() for lens in state.lenses]
        if self.layout.points:
            parts.append((state.points - self._start.points).ravel() / self._tolerance)
        if self.layout.clocks:
            parts.append(state.clocks[1:] / CLOCK_SIGMA)
        return np.concatenate(parts)

    def jacobian(self, x: Float64, noise_px: Float64) -> csr_matrix:
        """[m, n] of `weighted_residuals`."""
        state, blocks = self.unpack(x), _Blocks()
        for sighting in self._sightings:
            blocks.start_rows(2 * len(sighting.corners))
            self._add_sighting(
                blocks, state, sighting, -1 / float(np.hypot(noise_px[sighting.camera], sighting.jitter_px))
            )
        for i, _ in enumerate(self.layout.lens_sizes):
            block = state.lenses[i].priors_jacobian()
            blocks.start_rows(len(block))
            blocks.add(self.layout.lens(i).start, block)
        if self.layout.points:
            corners = self.layout.corners
            blocks.start_rows(corners.stop - corners.start)
            blocks.add(corners.start, np.eye(corners.stop - corners.start) / self._tolerance)
        if self.layout.clocks:
            blocks.start_rows(self.layout.clocks)
            blocks.add(self.layout.clock_offsets.start, np.eye(self.layout.clocks) / CLOCK_SIGMA)
        return blocks.matrix(len(x))

    def _add_sighting(self, blocks: _Blocks, state: BundleState, sighting: Sighting, weight: float) -> None:
        layout, camera = self.layout, sighting.camera
        pose = _seen(state, sighting)
        ids = sighting.corners.ids
        projection = project_points(state.lenses[camera], pose.rotation, pose.translation, state.points[ids])
        by_pose = np.concatenate([projection.by_rotation, projection.by_translation], axis=2).reshape(-1, 6) * weight
        blocks.add(layout.board(sighting.board).start, by_pose @ pose.by_board)
        if camera > 0:
            blocks.add(layout.camera(camera).start, by_pose @ pose.by_camera)
        if layout.lens_sizes:
            by_lens = projection.by_lens.reshape(2 * len(ids), -1)
            blocks.add(layout.lens(camera).start, by_lens * weight)
        if layout.points:
            by_point = projection.by_translation @ cv2.Rodrigues(pose.rotation)[0] * weight
            blocks.add_each(layout.corners.start + 3 * ids, by_point)
        if layout.clocks and camera > 0 and sighting.velocities is not None:
            blocks.add(layout.clock_offsets.start + camera - 1, sighting.velocities.reshape(-1, 1) * weight)


def adjust(start: BundleState, sightings: Sequence[Sighting], options: BundleOptions | None = None) -> BundleResult:
    """The state that explains all sightings best, from a start within the basin of convergence.

    Each camera's noise is estimated from its own residuals (median, so a third of bad corners does no harm).
    """
    problem = BundleProblem(start, sightings, options or BundleOptions())
    x, noise = problem.pack(start), np.ones(len(start.cameras))
    for _ in range(ROUNDS):
        x = _minimise(problem, x, noise)
        noise = _noise(problem.residuals(problem.unpack(x)), sightings, len(start.cameras))
        problem.measure_board(problem.unpack(x))
    state = problem.unpack(x)
    information = _information(problem.jacobian(x, noise))
    covariance = np.asarray(np.linalg.pinv(information, hermitian=True), np.float64)
    covariance *= _optimism(sightings, len(x))
    return BundleResult(state, problem.residuals(state), noise, covariance, problem.layout)


def _optimism(sightings: Sequence[Sighting], unknowns: int) -> float:
    """By how much residuals understate the variance of corners: unknowns absorb some of it, and interpolation more."""
    numbers = sum(2 * len(sighting.corners) for sighting in sightings)
    interpolated = any(sighting.velocities is not None for sighting in sightings)
    return numbers / max(numbers - unknowns, 1) / (INTERPOLATED_VARIANCE if interpolated else 1.0)


def board_pays(rigid: BundleResult, bent: BundleResult, sightings: Sequence[Sighting]) -> bool:
    """Whether a refined board explains enough for its unknowns (Bayesian information criterion, Schwarz 1978)."""
    counts = np.zeros(len(rigid.noise_px))
    for sighting in sightings:
        counts[sighting.camera] += 2 * len(sighting.corners)
    gain = float(counts @ np.log(rigid.noise_px / bent.noise_px))
    unknowns = 3 * bent.layout.points - 6  # where the board as a whole is, its poses say
    return bool(gain > unknowns / 2 * np.log(counts.sum()))


def _minimise(problem: BundleProblem, x: Float64, noise: Float64) -> Float64:
    """The unknowns of least robust cost.

    They are counted in units of the Cholesky factor of the information at the start, where the problem is almost round:
    SciPy's sparse solver then needs a few inner steps where it needs hundreds in metres, radians and pixels.
    """
    root = cholesky(_information(problem.jacobian(x, noise)))

    def moved(y: Float64) -> Float64:
        return x + np.asarray(solve_triangular(root, y), np.float64)

    def jacobian(y: Float64) -> LinearOperator:
        J = problem.jacobian(moved(y), noise)
        return LinearOperator(
            J.shape,
            matvec=lambda v: J @ solve_triangular(root, np.ravel(v)),
            rmatvec=lambda v: solve_triangular(root, J.T @ np.ravel(v), trans="T"),
            dtype=np.float64,
        )

    solution = least_squares(
        lambda y: problem.weighted_residuals(moved(y), noise),
        np.zeros(len(x)),
        jacobian,
        loss="soft_l1",
        f_scale=ROBUST_SIGMAS,
        tr_solver="lsmr",
        max_nfev=MAX_EVALUATIONS,
    )
    return moved(solution.x)


def _information(J: csr_matrix) -> Float64:
    """J^T J [n, n], made safely positive definite."""
    information: Float64 = (J.T @ J).toarray()
    information[np.diag_indices_from(information)] *= 1 + 1e-9
    return information


@dataclass(frozen=True)
class _Seen:
    """Pose of a board in an optical frame, and its derivatives [6, 6] by the poses that it is made of."""

    rotation: Float64
    translation: Float64
    by_board: Float64
    by_camera: Float64


def _seen(state: BundleState, sighting: Sighting) -> _Seen:
    board, camera = state.boards[sighting.board], state.cameras[sighting.camera]
    r, t, r_rb, r_tb, r_rc, r_tc, t_rb, t_tb, t_rc, t_tc = cv2.composeRT(board[:3], board[3:], camera[:3], camera[3:])
    by_board, by_camera = np.empty((6, 6)), np.empty((6, 6))
    by_board[:3, :3], by_board[:3, 3:], by_board[3:, :3], by_board[3:, 3:] = r_rb, r_tb, t_rb, t_tb
    by_camera[:3, :3], by_camera[:3, 3:], by_camera[3:, :3], by_camera[3:, 3:] = r_rc, r_tc, t_rc, t_tc
    return _Seen(np.asarray(r, np.float64).ravel(), np.asarray(t, np.float64).ravel(), by_board, by_camera)


class _Blocks:
    """Dense blocks of a sparse matrix, gathered row by row."""

    def __init__(self) -> None:
        self._rows: list[NDArray[np.int64]] = []
        self._columns: list[NDArray[np.int64]] = []
        self._values: list[Float64] = []
        self._start = 0
        self._end = 0

    def start_rows(self, count: int) -> None:
        """Begins the next `count` rows."""
        self._start, self._end = self._end, self._end + count

    def add(self, column: int, block: Float64) -> None:
        """A block [r, c] at a column."""
        self.add_each(np.array([column]), block[None])

    def add_each(self, columns: NDArray[np.int64], blocks: Float64) -> None:
        """Blocks [n, r, c] one below the other, each at its own column [n]."""
        n, r, c = blocks.shape
        rows = self._start + np.arange(n * r).reshape(n, r, 1)
        self._rows.append(np.broadcast_to(rows, blocks.shape).ravel())
        self._columns.append(np.broadcast_to(columns[:, None, None] + np.arange(c), blocks.shape).ravel())
        self._values.append(blocks.ravel())

    def matrix(self, columns: int) -> csr_matrix:
        """The matrix of all blocks."""
        place = (np.concatenate(self._rows), np.concatenate(self._columns))
        return coo_matrix((np.concatenate(self._values), place), shape=(self._end, columns)).tocsr()


def _noise(residuals: Sequence[Float64], sightings: Sequence[Sighting], cameras: int) -> Float64:
    """[C] 1 sigma per camera and axis, pixels."""
    noise = np.empty(cameras)
    for camera in range(cameras):
        own = [r for r, sighting in zip(residuals, sightings, strict=True) if sighting.camera == camera]
        noise[camera] = 1.4826 * np.median(np.abs(np.concatenate(own)))
    return np.maximum(noise, NOISE_FLOOR_PX)


def _step(points: Float64) -> float:
    """Median distance, m, from a corner of a board [P, 3] to the nearest other."""
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    return float(np.median(distances.min(axis=1)))
