"""Residuals of a bundle and the normal equations of their change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.sparse import csr_array

from twin_node.geometry import cross
from twin_node.rig.calibrate.board_shape import corner_step, sheet_shapes
from twin_node.rig.calibrate.bundle import BoardFreedom, BundleOptions, BundleState, Layout, Sighting
from twin_node.rig.calibrate.bundle_equations import BundleEquations, Change, Delays, Late
from twin_node.rig.calibrate.course import Blend, Placed
from twin_node.rig.calibrate.course_prior import Hands
from twin_node.rig.calibrate.lenses import project
from twin_node.rig.calibrate.normal_equations import NOWHERE, NormalEquations
from twin_node.rig.calibrate.rotations import cross_matrix, moved
from twin_node.rig.calibrate.stamp_jitter import LEAST_JITTER_S, measured_jitter
from twin_node.scene import Bool, Float64

BOARD_TOLERANCE = 0.01
"""1 sigma of a corner's place as a share of the distance between corners, where the board is refined: at first; from
the second round on what was measured. Paper bends and printers stretch, but no print is off by several of these."""

SHEET_SIGMA = 0.01
"""1 sigma of how much longer a print is along one side than along the other (rollers pull paper), and of how far it is
bowed, as a share of its diagonal."""

BOARD_TOLERANCE_FLOOR = 1e-4
"""No print is better than this share of the distance between corners."""

CLOCK_SIGMA_S = 0.1
"""1 sigma of a camera's clock offset: what a frame may wait in drivers and buffers (webcams: up to a few frames)."""

RATE_SIGMA = 100e-6
"""1 sigma of a clock's rate: crystals are sold as good to 20 to 100 ppm."""

READOUT_SIGMA_S = 0.02
"""1 sigma of a readout: none where all rows are exposed at once, up to a frame's period of 33 ms in webcams."""

ROBUST_SIGMAS = 2.0
"""Corners further off than so many sigma count linearly (soft L1): motion blur loses its pull."""


@dataclass(frozen=True)
class Look:
    """A state's projection of the board's P corners in all V images; zeros for what was not seen."""

    state: BundleState
    placed: Placed
    """The board at every image's time."""
    lags: Float64
    """[V, P] s from there to the time of the corner's row."""
    points: Float64
    """[V, P, 3] m of the board's axes at the image's time: the corners where they have turned to by their own times."""
    residuals: Float64
    """[V, P, 2] found minus projected, pixels."""
    by_point: Float64
    """[V, P, 2, 3] of the projection by the corner's place in the optical frame."""
    by_lens: Float64
    """[V, P, 2, L] of the projection by the longest lens's parameters; shorter ones leave zeros. L is 0 where they are
    fixed."""


@dataclass(frozen=True)
class _Slopes:
    """How what V images of one camera show changes, in sigmas."""

    J: Float64
    """[V, P, 2, m + L + 2] by the board's motions, the lens and the readout (left out where fixed); the residuals."""
    steering: Float64
    """[V, m, 24] of these motions by the four control poses' changes."""
    by_corner: Float64
    """[V, P, 2, 3] by the corners' places on the board."""


class BundleProblem:
    """What was seen, with a place for every corner of the board in every image, and what may change."""

    def __init__(self, start: BundleState, sightings: Sequence[Sighting], options: BundleOptions) -> None:
        self._start = start
        self.camera = np.array([sighting.camera for sighting in sightings])
        """[V]."""
        self.seen: Bool = np.zeros((len(sightings), len(start.points)), dtype=bool)
        """[V, P] which corners were found."""
        self._pixels = np.zeros((*self.seen.shape, 2))
        for view, sighting in enumerate(sightings):
            self.seen[view, sighting.corners.ids] = True
            self._pixels[view, sighting.corners.ids] = sighting.corners.pixels
        heights = np.array([lens.height for lens in start.lenses])[self.camera, None]
        self._rows = np.where(self.seen, (self._pixels[..., 1] + 0.5) / heights - 0.5, 0.0)
        """[V, P] shares of the image's height below its middle."""
        self._times = np.array([sighting.time_s for sighting in sightings])
        self._boards = np.array([sighting.board for sighting in sightings])
        cameras, moves = len(start.lenses), start.course.moves
        self._sheet = sheet_shapes(start.points) if options.board is BoardFreedom.SHEET else None
        """[3 P, n] m; None where no corner moves, or each by itself."""
        each = 3 * len(start.points) if options.board is BoardFreedom.BENT else 0
        self.layout = Layout(
            cameras,
            tuple(len(lens.parameters) for lens in start.lenses) if options.lenses else (),
            options.clocks and moves and cameras > 1,
            options.readouts and moves,
            each if self._sheet is None else int(self._sheet.shape[1]),
        )
        self._columns = self._outer_columns(max(self.layout.lens_sizes, default=0))
        places = self.seen & (self.camera == np.arange(cameras)[:, None])[..., None]
        self._places = [np.flatnonzero(own) for own in places]
        """Per camera: [N] of all V * P corners the ones that it found."""
        self.delayed = self.layout.clocks and options.delays
        """Whether stamps may be off one by one."""
        self.jitter = np.zeros(cameras)
        """[C] 1 sigma of each camera's delays, s; 0 where they are fixed, as at first."""
        self.hands = Hands()
        """How a board is moved: at first; from the second round on what was measured."""
        self._step = corner_step(start.points)
        self.tolerance = BOARD_TOLERANCE * self._step
        """1 sigma of a corner's place where each moves by itself, m; infinite: it may be anywhere."""

    def measure_board(self, state: BundleState) -> None:
        """Sets what the board's corners may be off by to what they are off by."""
        displacement = float(np.sqrt(np.mean((state.points - self._start.points) ** 2)))
        self.tolerance = max(displacement, BOARD_TOLERANCE_FLOOR * self._step)

    def measure_motion(self, look: Look, kept: Bool, noise_px: Float64) -> None:
        """Sets what hands and stamps may be off by to what they are off by, beyond what noise of the corners tells."""
        if not look.state.course.moves:
            return
        equations = self.equations(look, kept, noise_px)
        self.hands = self.hands.measured(look.state.course, equations.normal)
        if self.jitter.any():
            used = np.where(kept.any(axis=1), self.camera, NOWHERE)
            self.jitter = measured_jitter(equations, self.jitter, look.state.delays, used)

    def look(self, state: BundleState) -> Look:
        """Where a state would have everything be seen."""
        placed = state.course.at(self._blend(state))
        lags = state.readouts[self.camera, None] * self._rows
        points = state.points + lags[..., None] * cross(placed.speeds[:, None, :3], state.points)
        shifted = placed.positions[:, None] + lags[..., None] * placed.speeds[:, None, 3:]
        in_rig = (points @ placed.rotations.swapaxes(1, 2) + shifted).reshape(-1, 3)
        pixels = self._pixels.reshape(-1, 2)
        residuals = np.zeros_like(pixels)
        by_point = np.zeros((*residuals.shape, 3))
        by_lens = np.zeros((*residuals.shape, max(self.layout.lens_sizes, default=0)))
        for lens, T, own in zip(state.lenses, state.T_cam_rig, self._places, strict=True):
            projection = project(lens, in_rig[own] @ T[:3, :3].T + T[:3, 3])
            residuals[own] = pixels[own] - projection.pixels
            by_point[own] = projection.by_point
            if self.layout.lens_sizes:
                by_lens[own, :, : projection.by_lens.shape[-1]] = projection.by_lens
        shape = self._pixels.shape
        by_point, by_lens = by_point.reshape(*shape, 3), by_lens.reshape(*shape, by_lens.shape[-1])
        return Look(state, placed, lags, points, residuals.reshape(shape), by_point, by_lens)

    def cost(self, look: Look, kept: Bool, noise_px: Float64) -> float:
        """Half the robust sum of squares, in sigmas, of the corners that are kept and of all priors."""
        state = look.state
        square = (look.residuals[kept] ** 2).sum(-1) / np.repeat(noise_px[self.camera] ** 2, kept.sum(1))
        robust = soft_l1(square)
        lenses = sum(float((lens.priors() ** 2).sum()) for lens in state.lenses) if self.layout.lens_sizes else 0.0
        board = float((self._shape(state) ** 2).sum())
        clocks = float(((state.clocks / [CLOCK_SIGMA_S, RATE_SIGMA]) ** 2).sum())
        clocks += float(((state.readouts / READOUT_SIGMA_S) ** 2).sum())
        clocks += float(((state.delays / np.maximum(self.jitter, LEAST_JITTER_S)[self.camera]) ** 2).sum())
        return 0.5 * (
            float(robust.sum()) + lenses + board + clocks + float((self.hands.roughness(state.course) ** 2).sum())
        )

    def equations(self, look: Look, kept: Bool, noise_px: Float64) -> BundleEquations:
        """The equations about a state."""
        state = look.state
        reach = 4 if state.course.moves else 1
        equations = NormalEquations(6 * len(state.course.quats), 6 * reach - 1, self.layout.size)
        weights, controls = self._weights(look, kept, noise_px), self._blend(state).controls
        late = []
        for camera in range(self.layout.cameras):
            # In the order of the course, so that images that share control poses are summed up before they are added.
            views = np.flatnonzero(self.camera == camera)
            views = views[np.argsort(controls[views, 0], kind="stable")]
            late += self._add_camera(equations, look, weights, views, controls[views])
        self.hands.add_to(equations, state.course)
        self._add_priors(equations, state)
        return BundleEquations(equations, tuple(late), len(self.camera))

    def changed(self, state: BundleState, change: Change) -> BundleState:
        """The state after a change."""
        layout, outer = self.layout, change.outer
        cameras = np.concatenate([np.zeros((1, 6)), outer[: 6 * (layout.cameras - 1)].reshape(-1, 6)])
        lenses = state.lenses
        if layout.lens_sizes:
            lenses = tuple(s.with_parameters(s.parameters + outer[layout.lens(i)]) for i, s in enumerate(lenses))
        clocks = state.clocks
        if layout.clocks:
            own = outer[layout.clock(1).start : layout.clock(layout.cameras - 1).stop]
            clocks = clocks + np.concatenate([np.zeros((1, 2)), own.reshape(-1, 2)])
        readouts = state.readouts
        if layout.readouts:
            readouts = readouts + outer[layout.readout(0).start : layout.readout(layout.cameras - 1).stop]
        points = state.points
        if layout.shape:
            shape = outer[layout.board]
            points = points + (shape if self._sheet is None else self._sheet @ shape).reshape(-1, 3)
        return replace(
            state,
            T_cam_rig=moved(state.T_cam_rig, cameras),
            course=state.course.changed(change.inner.reshape(-1, 6)),
            lenses=lenses,
            points=points,
            clocks=clocks,
            readouts=readouts,
            delays=state.delays + change.delays,
        )

    def covariance(self, look: Look, kept: Bool, noise_px: Float64) -> Float64:
        """[n, n] of the unknowns in `layout`, of an M-estimate (Huber, Robust Statistics, 1981, section 7.6)."""
        square = (look.residuals[kept] ** 2).sum(-1) / np.repeat(noise_px[self.camera] ** 2, kept.sum(1))
        s = square / ROBUST_SIGMAS**2
        pull, bend = square / (1 + s) / 2, (1 + s) ** -0.5 - 0.5 * s * (1 + s) ** -1.5
        spare = max(1 - (6 * len(look.state.course.quats) + self.layout.size) / (2 * len(square)), 0.1)
        plain = np.zeros_like(look.residuals)
        equations = self.equations(replace(look, residuals=plain), kept, noise_px)
        return equations.normal.outer_covariance() * float(pull.mean()) / spare / float(bend.mean()) ** 2

    def _blend(self, state: BundleState) -> Blend:
        """What the board's poses at all images' times are made of."""
        return state.course.blend(self._boards, state.rig_times(self.camera, self._times) + state.delays)

    def _weights(self, look: Look, kept: Bool, noise_px: Float64) -> Float64:
        """[V, P] what residuals (pixels) times which are in sigmas, far ones counted for less; 0: not kept."""
        square = (look.residuals**2).sum(-1) / noise_px[self.camera, None] ** 2
        return np.where(kept, (1 + square / ROBUST_SIGMAS**2) ** -0.25, 0.0) / noise_px[self.camera, None]

    def _outer_columns(self, lens_parameters: int) -> NDArray[np.int64]:
        """[C, 6 + 2 + L + 1] outer columns of each camera's pose, clock, lens and readout; `NOWHERE` for what is fixed.

        The last is left out where readouts are fixed.
        """
        layout = self.layout
        columns = np.full((layout.cameras, 8 + lens_parameters + layout.readouts), NOWHERE)
        for i in range(layout.cameras):
            last = (8 + lens_parameters, layout.readout(i))
            for place, own in ((0, layout.camera(i)), (6, layout.clock(i)), (8, layout.lens(i)), last):
                columns[i, place : place + own.stop - own.start] = np.arange(own.start, own.stop)
        return columns

    def _add_camera(
        self,
        equations: NormalEquations,
        look: Look,
        weights: Float64,
        views: NDArray[np.int64],
        controls: NDArray[np.int64],
    ) -> list[Late]:
        """The images `views` of one camera, in the order of the `controls` that their boards' poses are made of.

        Their delays are eliminated; what these come to is told.
        """
        if not len(views):
            return []
        camera, slopes = self.camera[views[0]], self._slopes(look, weights, views)
        J, steering, motions = slopes.J, slopes.steering, slopes.steering.shape[1]
        rows = J.reshape(len(views), -1, J.shape[-1])
        squares = rows.swapaxes(1, 2) @ rows
        products, alone = self._by_shape(J, slopes.by_corner)
        delays = self._delays(look, squares, products, views)
        if delays is not None:
            squares = squares - delays.products(delays.by_image)
        # An image's whole board moves alike, whatever moves it: the first columns hold all that there is to know.
        steered, own = steering.swapaxes(1, 2), self._own_motions(look, views, motions, J.shape[-1])
        by_own = squares @ own
        outer_squares = (own.swapaxes(1, 2) @ by_own).sum(0)
        by_inner = [squares[:, :motions, :motions] @ steering, by_own[:, :motions]]
        groups = np.flatnonzero(np.diff(controls[:, 0], prepend=-1))
        inner_squares = _summed(steered @ np.concatenate(by_inner, axis=2), groups)
        inner = (6 * controls[groups, :, None] + np.arange(6)).reshape(len(groups), 24)
        outer = self._columns[camera]
        equations.add_inner(inner, inner_squares[:, :, :24], inner_squares[:, :, -1])
        equations.add_outer(outer, outer_squares[:-1, :-1], outer_squares[:-1, -1])
        equations.add_mixed(inner, outer, inner_squares[:, :, 24:-1])
        board = np.arange(self.layout.board.start, self.layout.board.stop)
        if self.layout.shape:
            if delays is not None:
                products = products - delays.products(delays.by_board)
                alone = alone - np.einsum("vi,v,vj->ij", delays.by_board, 1 / delays.told, delays.by_board)
            by_board = (own.swapaxes(1, 2) @ products).sum(0)
            equations.add_mixed(inner, board, _summed(steered @ products[:, :motions], groups))
            equations.add_between(outer, board, by_board[:-1])
            equations.add_outer(board, alone, by_board[-1])
        if delays is None:
            return []
        by_steering = (delays.by_image[:, None, :motions] @ steering)[:, 0]
        by_outer = (delays.by_image[:, None] @ own)[:, 0, :-1]
        columns = 6 * controls[:, :, None] + np.arange(6)
        return [Late(views, columns.reshape(-1, 24), by_steering, outer, by_outer, board, delays)]

    def _delays(self, look: Look, squares: Float64, products: Float64, views: NDArray[np.int64]) -> Delays | None:
        """What the images `views` of one camera tell of their delays; None where these are fixed."""
        jitter = self.jitter[self.camera[views[0]]]
        if not jitter:
            return None
        speeds = look.placed.speeds[views]
        by_image = (squares[:, :, :6] @ speeds[..., None])[..., 0]
        by_image[:, -1] -= look.state.delays[views] / jitter**2
        told = (by_image[:, :6] * speeds).sum(1) + jitter**-2
        return Delays(by_image, (speeds[:, None] @ products[:, :6])[:, 0], told)

    def _by_shape(self, J: Float64, by_corner: Float64) -> tuple[Float64, Float64]:
        """[V, k, n] and [n, n] products of what the board's shape changes with all else, and with itself."""
        views, columns = len(J), J.shape[-1]
        if not self.layout.shape:
            return np.zeros((views, columns, 0)), np.zeros((0, 0))
        if self._sheet is None:
            products = np.einsum("vpai,vpaj->vipj", J, by_corner).reshape(views, columns, -1)
            return products, block_diag(*np.einsum("vpai,vpaj->pij", by_corner, by_corner))
        by_sheet = np.einsum("vpai,pij->vpaj", by_corner, self._sheet.reshape(-1, 3, self.layout.shape))
        rows = by_sheet.reshape(views, -1, self.layout.shape)
        products = J.reshape(views, -1, columns).swapaxes(1, 2) @ rows
        return products, (rows.swapaxes(1, 2) @ rows).sum(0)

    def _shape(self, state: BundleState) -> Float64:
        """What of the board's shape is held, in sigmas."""
        off = (state.points - self._start.points).ravel()
        return off / self.tolerance if self._sheet is None else np.linalg.pinv(self._sheet) @ off / SHEET_SIGMA

    def _slopes(self, look: Look, weights: Float64, views: NDArray[np.int64]) -> _Slopes:
        """How what the images `views` of one camera show changes."""
        state, placed, weight = look.state, look.placed, weights[views, :, None, None]
        by_rig = look.by_point[views] * weight @ state.T_cam_rig[self.camera[views[0]], :3, :3]
        by_board = (by_rig.reshape(len(views), -1, 3) @ placed.rotations[views]).reshape(by_rig.shape)
        # Where a point x is turned about the origin, a row a of derivatives by its place becomes x cross a.
        motions, steering = [cross(look.points[views, :, None], by_board), by_rig], placed.by_control[views]
        others, by_corner = [look.by_lens[views] * weight], by_board
        if self.layout.readouts:
            lags, speeds = look.lags[views, :, None, None], placed.speeds[views, None, None]
            by_turning = cross(state.points[:, None], by_board)
            motions += [lags * by_turning, lags * by_rig]
            steering = np.concatenate([steering, placed.speeds_by_control[views]], axis=1)
            by_time = (by_turning * speeds[..., :3] + by_rig * speeds[..., 3:]).sum(-1, keepdims=True)
            others.append(by_time * self._rows[views, :, None, None])
            by_corner = by_board + lags * cross(by_board, speeds[..., :3])
        residuals = look.residuals[views, ..., None] * weight
        return _Slopes(np.concatenate([*motions, *others, residuals], axis=-1), steering, by_corner)

    def _own_motions(self, look: Look, views: NDArray[np.int64], motions: int, columns: int) -> Float64:
        """[V, columns, columns - motions + 8] from the board's motions to what moves it before one camera.

        Motions are its turn and position and, where rows have times of their own, the speeds of these. What moves it is
        the camera's pose and clock; what follows, its lens, its readout and the residuals, is left as it is.
        """
        state, placed = look.state, look.placed
        T = state.T_cam_rig[self.camera[views[0]]]
        out = np.zeros((len(views), columns, columns - motions + 8))
        out[:, :3, :3] = (T[:3, :3] @ placed.rotations[views]).swapaxes(1, 2)
        out[:, 3:6, :3] = (T[:3, :3] @ cross_matrix(placed.positions[views])).swapaxes(1, 2)
        out[:, 3:6, 3:6] = T[:3, :3].T
        if motions > 6:
            out[:, 9:12, :3] = (T[:3, :3] @ cross_matrix(placed.speeds[views, 3:])).swapaxes(1, 2)
        out[:, :6, 6] = placed.speeds[views]
        out[:, :6, 7] = placed.speeds[views] * (self._times[views] - state.reference_s)[:, None]
        out[:, motions:, 8:] = np.eye(columns - motions)
        return out

    def _add_priors(self, equations: NormalEquations, state: BundleState) -> None:
        layout = self.layout
        for i, lens in enumerate(state.lenses if layout.lens_sizes else ()):
            J, columns = lens.priors_jacobian(), np.arange(layout.lens(i).start, layout.lens(i).stop)
            equations.add_outer(columns, J.T @ J, -J.T @ lens.priors())
        if layout.clocks:
            columns = np.arange(layout.clock(1).start, layout.clock(layout.cameras - 1).stop)
            weights = np.tile([CLOCK_SIGMA_S**-2, RATE_SIGMA**-2], layout.cameras - 1)
            equations.add_outer(columns, np.diag(weights), -weights * state.clocks[1:].ravel())
        if layout.readouts:
            columns = np.arange(layout.readout(0).start, layout.readout(layout.cameras - 1).stop)
            equations.add_outer(
                columns, np.eye(len(columns)) / READOUT_SIGMA_S**2, -state.readouts / READOUT_SIGMA_S**2
            )
        if layout.shape:
            columns = np.arange(layout.board.start, layout.board.stop)
            sigma = self.tolerance if self._sheet is None else SHEET_SIGMA
            equations.add_outer(columns, np.eye(len(columns)) / sigma**2, -self._shape(state) / sigma)


def soft_l1(square: Float64) -> Float64:
    """[N] what squares [N], in sigmas, count for."""
    return np.asarray(2 * ROBUST_SIGMAS**2 * (np.sqrt(1 + square / ROBUST_SIGMAS**2) - 1))


def _summed(values: Float64, groups: NDArray[np.int64]) -> Float64:
    """[G, ...] sums of values [V, ...] from each of the rows `groups` to the next."""
    if len(groups) == len(values):
        return values
    counts = np.append(groups, len(values))
    adder = csr_array((np.ones(len(values)), np.arange(len(values)), counts))
    return np.asarray(adder @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])
