"""The bundle's derivatives, the course of a board, and what is made of boards that are not flat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from simulated_boards import a_lens, around, seen_corners, waved

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.boards import Chessboard, Corners
from twin_node.rig.calibrate.bundle import BoardFreedom, BundleOptions, BundleState, Sighting
from twin_node.rig.calibrate.bundle_equations import Change
from twin_node.rig.calibrate.bundle_problem import BundleProblem
from twin_node.rig.calibrate.bundle_solver import board_pays, could_pay, minimise, solve_bundle
from twin_node.rig.calibrate.course import Course, smooth_course, still_course
from twin_node.rig.calibrate.normal_equations import NormalEquations, inverse_band
from twin_node.rig.calibrate.rotations import moved
from twin_node.scene import Float64

BOARD = Chessboard(5, 4, 0.06)
IMAGES = 24
"""Of each camera before a moving board."""
MODELS = ["plumb_bob", "rational_polynomial", "equidistant"]


def cameras() -> Float64:
    """[2, 4, 4] `T_cam_rig` of two cameras in the first one's frame."""
    poses = around(2, radius=1.0)
    return np.stack([inverse_pose(T) @ poses[0] for T in poses])


def in_rig(poses: Float64) -> Float64:
    """Boards as the first camera's frame has them."""
    return inverse_pose(around(2, radius=1.0)[0]) @ poses


def a_still_state(model: str, sets: int = 3) -> BundleState:
    boards = in_rig(np.stack([waved(1.3 * n) for n in range(sets)]))
    lenses = (a_lens(model), a_lens(model))
    return BundleState(
        cameras(), still_course(boards), lenses, BOARD.points, np.zeros((2, 2)), np.zeros(2), np.zeros(2 * sets)
    )


def a_moving_state(model: str, readouts: tuple[float, float] = (0.0, 0.0)) -> BundleState:
    times = np.arange(0, 1.5, 0.05)
    course = smooth_course([times], [in_rig(np.stack([waved(t) for t in times]))], 0.1)
    clocks = np.array([[0.0, 0.0], [0.02, 1e-4]])
    lenses = (a_lens(model), a_lens(model))
    return BundleState(cameras(), course, lenses, BOARD.points, clocks, np.array(readouts), np.zeros(2 * IMAGES), 0.7)


def pose_at(course: Course, board: int, time: float) -> Float64:
    placed = course.at(course.blend(np.array([board]), np.array([time])))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = placed.rotations[0], placed.positions[0]
    return T


def sightings_of(
    state: BundleState, rng: np.random.Generator, noise: float = 0.1, bend: Float64 | None = None
) -> list[Sighting]:
    """What a state's cameras see of the board (bent: its points moved)."""
    moving = state.course.stretches[0].count > 1
    places = (
        [(0, t) for t in 0.1 + 0.05 * np.arange(IMAGES)]
        if moving
        else [(n, 0.0) for n in range(len(state.course.quats))]
    )
    bent = _Bent(BOARD.points if bend is None else BOARD.points + bend)
    out = []
    for camera, lens in enumerate(state.lenses):
        for board, time in places:
            at = float(state.rig_times(np.array([camera]), np.array([time]))[0])
            seen = seen_corners(bent, lens, state.T_cam_rig[camera] @ pose_at(state.course, board, at))
            if seen is not None and len(seen) > 6:
                pixels = seen.pixels + rng.normal(0, noise, seen.pixels.shape)
                out.append(Sighting(camera, board, Corners(seen.ids, pixels), time))
    return out


class _Bent:
    """A board whose points are where they are put."""

    def __init__(self, points: Float64) -> None:
        self.points = points


@pytest.mark.parametrize(
    ("model", "moving", "board"),
    [
        *((model, moving, BoardFreedom.BENT) for model in MODELS for moving in (False, True)),
        *(("plumb_bob", moving, BoardFreedom.SHEET) for moving in (False, True)),
    ],
)
def test_the_normal_equations_are_the_cost_s_derivative(model: str, moving: bool, board: BoardFreedom) -> None:
    rng = np.random.default_rng(3)
    state = a_moving_state(model, (0.01, -0.02)) if moving else a_still_state(model)
    problem = BundleProblem(
        state, sightings_of(state, rng, noise=1.0), BundleOptions(lenses=True, board=board, delays=False)
    )
    noise, kept = np.array([0.7, 1.3]), problem.seen & (rng.uniform(size=problem.seen.shape) < 0.9)
    course = state.course.changed(rng.normal(0, 1e-3, (len(state.course.quats), 6)))
    state = replace(state, course=course, points=state.points + rng.normal(0, 1e-4, state.points.shape))
    inner, outer = problem.equations(problem.look(state), kept, noise).normal.slopes

    def cost(change: Float64) -> float:
        still = np.zeros(len(state.delays))
        tried = problem.changed(state, Change(change[: len(inner)], change[len(inner) :], still))
        return problem.cost(problem.look(tried), kept, noise)

    expected = -np.concatenate([inner, outer])
    told = [*range(len(inner), len(expected))[problem.layout.clock(1)], len(expected) - 2, len(expected) - 1]
    for n in [*rng.permutation(len(expected))[:25].tolist(), *told]:
        step = np.zeros(len(expected))
        step[n] = 1e-6 if n < len(inner) + 6 or n >= len(inner) + 6 + problem.layout.lens_sizes[0] * 2 else 1e-4
        numeric = (cost(step) - cost(-step)) / (2 * step[n])
        assert numeric == pytest.approx(expected[n], rel=2e-3, abs=2e-3 * (1 + np.abs(expected).max() * 1e-3))


def test_with_delays_of_single_stamps_a_solution_is_one_in_all_unknowns() -> None:
    rng, state = np.random.default_rng(4), a_moving_state("plumb_bob", (0.01, -0.02))
    problem = BundleProblem(
        state, sightings_of(state, rng, noise=1.0), BundleOptions(lenses=True, board=BoardFreedom.BENT)
    )
    noise, problem.jitter = np.ones(2), np.full(2, 0.005)
    found = minimise(problem, problem.look(state), problem.seen, noise, 1e-14).state
    sizes = (6 * len(state.course.quats), problem.layout.size, len(state.delays))
    assert np.abs(found.delays).max() > 1e-4

    def cost(change: Float64) -> float:
        tried = problem.changed(found, Change(*np.split(change, np.cumsum(sizes)[:-1])))
        return problem.cost(problem.look(tried), problem.seen, noise)

    for n in rng.permutation(sum(sizes))[:40]:
        step = np.zeros(sum(sizes))
        step[n] = 1e-5
        rise = cost(step) + cost(-step) - 2 * cost(0 * step)  # h^2 times the curvature
        slope = (cost(step) - cost(-step)) / 2
        assert abs(slope) < 0.02 * np.sqrt(max(rise, 0)) + 1e-7  # within a fiftieth of a sigma of the lowest


def test_eliminating_the_inner_unknowns_changes_no_solution() -> None:
    rng = np.random.default_rng(1)
    equations, J = NormalEquations(9, 5, 4), np.zeros((40, 13))
    residuals = rng.normal(size=40)
    for row in range(0, 40, 4):
        first = rng.integers(0, 4)
        inner, outer = np.arange(first, first + 6), np.arange(4)
        J[row : row + 4, inner] = rng.normal(size=(4, 6))
        J[row : row + 4, 9 + outer] = rng.normal(size=(4, 4))
        A, B, r = J[row : row + 4, inner], J[row : row + 4, 9 + outer], residuals[row : row + 4]
        equations.add_inner(inner[None], (A.T @ A)[None], (A.T @ r)[None])
        equations.add_outer(outer, B.T @ B, B.T @ r)
        equations.add_mixed(inner[None], outer, (A.T @ B)[None])
    found = np.concatenate(equations.solution(0.0))
    np.testing.assert_allclose(found, np.linalg.lstsq(J, residuals, rcond=None)[0], atol=1e-5)
    covariance = np.linalg.inv(J.T @ J)
    np.testing.assert_allclose(equations.outer_covariance(), covariance[9:, 9:], atol=1e-5)
    columns, by_inner, by_outer = np.array([[0, 3], [4, 8]]), rng.normal(size=(2, 2)), rng.normal(size=(2, 4))
    sums = np.zeros((2, 13))
    sums[[0, 0, 1, 1], columns.ravel()], sums[:, 9:] = by_inner.ravel(), by_outer
    expected = np.diag(sums @ covariance @ sums.T)
    np.testing.assert_allclose(equations.variances(columns, by_inner, by_outer), expected, rtol=1e-4)


@settings(max_examples=10)
@given(phase=st.floats(0, 6), step=st.floats(0.1, 0.15), bad=st.integers(0, 2))
def test_a_course_goes_where_the_board_went_whatever_was_misread(phase: float, step: float, bad: int) -> None:
    rng = np.random.default_rng(bad)
    times = np.arange(0, 4, 0.04)
    poses = np.stack([waved(t, phase) for t in times])
    wrong = rng.permutation(len(times))[: 5 * bad]
    spoiled = poses.copy()
    spoiled[wrong] = moved(poses[wrong], rng.normal(0, 0.3, (len(wrong), 6)))
    course = smooth_course([times], [spoiled], step)
    placed = course.at(course.blend(np.zeros(len(times), np.int64), times))
    away = np.linalg.norm(placed.positions - poses[:, :3, 3], axis=1)
    turned = Rotation.from_matrix(placed.rotations.swapaxes(1, 2) @ poses[:, :3, :3]).magnitude()
    assert np.median(away) < (0.005 if bad else 0.001)
    assert np.median(turned) < (0.02 if bad else 0.005)


def test_the_course_knows_its_speed() -> None:
    course = a_moving_state("plumb_bob").course
    ahead, behind = pose_at(course, 0, 0.7 + 1e-4), pose_at(course, 0, 0.7 - 1e-4)
    speeds = course.at(course.blend(np.zeros(1, np.int64), np.array([0.7]))).speeds[0]
    turn = Rotation.from_matrix(behind[:3, :3].T @ ahead[:3, :3]).as_rotvec() / 2e-4
    np.testing.assert_allclose(speeds, [*turn, *(ahead[:3, 3] - behind[:3, 3]) / 2e-4], rtol=1e-4, atol=1e-6)


def test_clocks_are_told_by_the_motion() -> None:
    state = a_moving_state("plumb_bob")
    seen = sightings_of(state, np.random.default_rng(0), noise=0.05)
    start = replace(state, clocks=np.zeros((2, 2)))
    result = solve_bundle(start, seen, BundleOptions(lenses=False))
    sigma = float(np.sqrt(np.diag(result.covariance)[result.layout.clock(1)])[0])
    assert 1e-4 < sigma < 0.005
    assert abs(result.state.clocks[1, 0] - 0.02) < 4 * sigma


def test_one_stamp_that_is_off_says_little_of_a_camera_s_others() -> None:
    state = a_moving_state("plumb_bob")
    seen = sightings_of(state, np.random.default_rng(0), noise=0.3)
    seen[10] = replace(seen[10], time_s=seen[10].time_s - 0.03)
    result = solve_bundle(state, seen, BundleOptions(lenses=False))
    assert result.jitter_s[0] < 0.003  # 0.03 s among 24 images is 0.006 s, all counted alike
    assert result.jitter_s[1] < 0.0001


def test_how_evenly_a_board_was_moved_is_told_by_its_course() -> None:
    rng, state = np.random.default_rng(2), a_moving_state("plumb_bob")
    step, places = state.course.stretches[0].step_s, state.course.positions
    shaken = places + rng.normal(0, 8.0 * step**2 / np.sqrt(6), places.shape)  # 1 + 4 + 1 shares of second differences
    state = replace(state, course=replace(state.course, positions=shaken))
    seen = sightings_of(state, rng)
    state = replace(state, delays=np.zeros(len(seen)))
    problem = BundleProblem(state, seen, BundleOptions(delays=False))
    for _ in range(4):
        problem.measure_motion(problem.look(state), problem.seen, np.ones(2))
    assert problem.hands.moving == pytest.approx(8.0, rel=0.4)
    assert problem.hands.turning < 30.0


def test_the_inverse_of_a_banded_matrix_is_known_within_its_band() -> None:
    rng = np.random.default_rng(0)
    for count, band in ((1, 5), (6, 5), (40, 5), (40, 0)):
        full = rng.normal(size=(count, count)) + 3 * count * np.eye(count)
        full = np.tril(np.triu(full, -band))
        full += np.tril(full, -1).T
        A = np.zeros((band + 1, count))
        for lag in range(min(band + 1, count)):
            A[lag, : count - lag] = np.diag(full, -lag)
        inverse = inverse_band(A)
        for lag in range(min(band + 1, count)):
            np.testing.assert_allclose(inverse[lag, : count - lag], np.diag(np.linalg.inv(full), -lag), atol=1e-14)


def test_how_sure_an_estimate_is_is_worked_out_once_and_when_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, covariance = [], BundleProblem.covariance
    monkeypatch.setattr(BundleProblem, "covariance", lambda *args: asked.append(args) or covariance(*args))
    state = a_moving_state("plumb_bob")
    result = solve_bundle(state, sightings_of(state, np.random.default_rng(0), noise=0.05), BundleOptions(lenses=False))
    assert not asked
    assert result.covariance is result.covariance
    assert len(asked) == 1


def test_a_bent_board_is_found_bent_and_a_flat_one_flat() -> None:
    rng = np.random.default_rng(4)
    state = a_still_state("plumb_bob", sets=14)
    bow = np.zeros_like(BOARD.points)
    x = BOARD.points[:, 0] - BOARD.points[:, 0].mean()
    bow[:, 2] = 0.006 * (1 - (x / x.max()) ** 2)
    for bend, expected in ((None, False), (bow, True)):
        seen = sightings_of(state, rng, bend=bend)
        rigid, free = solve_bundle(state, seen), solve_bundle(state, seen, BundleOptions(board=BoardFreedom.BENT))
        assert board_pays(rigid, free) is expected
        assert could_pay(rigid, seen, BundleOptions(board=BoardFreedom.BENT)) is expected
        if bend is not None:
            found = (free.state.points - BOARD.points)[:, 2]
            assert abs(np.ptp(found) - np.ptp(bow[:, 2])) < 0.2 * np.ptp(bow[:, 2])
