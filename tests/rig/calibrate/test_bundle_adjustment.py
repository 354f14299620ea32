"""The bundle's derivatives, and what it makes of boards that are not flat."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_boards import a_lens, around, seen_corners, waved

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.boards import Chessboard, Corners
from twin_node.rig.calibrate.bundle import (
    BundleOptions,
    BundleProblem,
    BundleState,
    Sighting,
    adjust,
    board_pays,
)
from twin_node.rig.calibrate.rotations import as_pose, as_vector, right_jacobian
from twin_node.scene import Float64

BOARD = Chessboard(5, 4, 0.06)
MODELS = ["plumb_bob", "rational_polynomial", "equidistant"]


def a_state(model: str, sets: int = 3) -> BundleState:
    """Two cameras in the first one's frame, and boards."""
    poses = around(2, radius=1.0)
    cameras = np.stack([as_vector(inverse_pose(T) @ poses[0]) for T in poses])
    boards = np.stack([as_vector(inverse_pose(poses[0]) @ waved(1.3 * n)) for n in range(sets)])
    return BundleState(cameras, boards, (a_lens(model), a_lens(model)), BOARD.points, np.zeros(2))


def sightings_of(
    state: BundleState, rng: np.random.Generator, noise: float = 0.1, bend: Float64 | None = None
) -> list[Sighting]:
    """What a state's cameras see of the board (bent: its points moved)."""
    out = []
    for camera, lens in enumerate(state.lenses):
        for number, board in enumerate(state.boards):
            bent = _Bent(BOARD.points if bend is None else BOARD.points + bend)
            seen = seen_corners(bent, lens, as_pose(state.cameras[camera]) @ as_pose(board))  # type: ignore[arg-type]
            if seen is not None and len(seen) > 6:
                pixels = seen.pixels + rng.normal(0, noise, seen.pixels.shape)
                out.append(Sighting(camera, number, Corners(seen.ids, pixels), rng.normal(0, 30, pixels.shape)))
    return out


class _Bent:
    """A board whose points are where they are put."""

    def __init__(self, points: Float64) -> None:
        self.points = points


@pytest.mark.parametrize("model", MODELS)
def test_the_jacobian_is_the_residuals_derivative(model: str) -> None:
    rng = np.random.default_rng(3)
    state = a_state(model)
    problem = BundleProblem(state, sightings_of(state, rng), BundleOptions(lenses=True, board=True, clocks=True))
    x, noise = problem.pack(state), np.array([0.7, 1.3])
    x = x + rng.normal(0, 1e-3, len(x))
    J = problem.jacobian(x, noise).toarray()
    steps = 1e-6 * np.maximum(1, np.abs(x))
    for n, step in enumerate(steps):
        ahead, behind = x.copy(), x.copy()
        ahead[n] += step
        behind[n] -= step
        numeric = problem.weighted_residuals(ahead, noise) - problem.weighted_residuals(behind, noise)
        numeric /= 2 * step
        np.testing.assert_allclose(J[:, n], numeric, rtol=1e-4, atol=1e-4 * (1 + np.abs(numeric).max()))


def test_packing_and_unpacking_are_inverse() -> None:
    state = a_state("plumb_bob")
    problem = BundleProblem(state, sightings_of(state, np.random.default_rng(0)), BundleOptions(board=True))
    again = problem.unpack(problem.pack(state))
    np.testing.assert_array_equal(again.cameras, state.cameras)
    np.testing.assert_array_equal(again.boards, state.boards)
    np.testing.assert_array_equal(again.points, state.points)
    np.testing.assert_array_equal(again.lenses[1].parameters, state.lenses[1].parameters)


def test_a_bent_board_is_found_bent_and_a_flat_one_flat() -> None:
    rng = np.random.default_rng(4)
    state = a_state("plumb_bob", sets=14)
    bow = np.zeros_like(BOARD.points)
    x = BOARD.points[:, 0] - BOARD.points[:, 0].mean()
    bow[:, 2] = 0.006 * (1 - (x / x.max()) ** 2)
    for bend, expected in ((None, False), (bow, True)):
        seen = [Sighting(s.camera, s.board, s.corners) for s in sightings_of(state, rng, bend=bend)]
        rigid = adjust(state, seen, BundleOptions(board=False))
        free = adjust(state, seen, BundleOptions(board=True))
        assert board_pays(rigid, free, seen) is expected
        if bend is not None:
            found = (free.state.points - BOARD.points)[:, 2]
            assert abs(np.ptp(found) - np.ptp(bow[:, 2])) < 0.2 * np.ptp(bow[:, 2])


def test_the_right_jacobian_is_the_turn_by_a_change_of_the_vector() -> None:
    for vector in (np.array([0.3, -1.2, 0.8]), np.array([1e-9, 0.0, 0.0])):
        change = 1e-6 * np.array([0.2, -0.5, 0.4])
        turned = Rotation.from_rotvec(vector).inv() * Rotation.from_rotvec(vector + change)
        np.testing.assert_allclose(turned.as_rotvec(), right_jacobian(vector) @ change, atol=1e-11)
