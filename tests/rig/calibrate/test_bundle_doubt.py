"""How sure a bundle says it is, and how far off it takes its board and its stamps to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_bundle_adjustment import BOARD, a_moving_state, a_still_state, sightings_of

from twin_node.rig.calibrate.boards import Corners
from twin_node.rig.calibrate.bundle import BoardFreedom, BundleOptions, BundleState, Sighting
from twin_node.rig.calibrate.bundle_problem import BundleProblem
from twin_node.rig.calibrate.bundle_solver import minimise, solve_bundle
from twin_node.scene import Float64

FIXED = BundleOptions(lenses=False)
NOISE_PX = 0.5


def spoiled(seen: list[Sighting], rng: np.random.Generator, far: float) -> list[Sighting]:
    """Sightings with noise, eight times as much of it on a share `far` of their corners."""
    out = []
    for sighting in seen:
        noise = rng.normal(0, NOISE_PX, sighting.corners.pixels.shape)
        noise[rng.uniform(size=len(noise)) < far] *= 8
        out.append(replace(sighting, corners=Corners(sighting.corners.ids, sighting.corners.pixels + noise)))
    return out


def off_by(found: Float64, true: Float64) -> Float64:
    """[6] how far a pose [4, 4] is off, as the unknowns of a bundle tell it."""
    turn = Rotation.from_matrix(found[:3, :3] @ true[:3, :3].T).as_rotvec()
    return np.concatenate([turn, found[:3, 3] - true[:3, 3]])


@pytest.mark.parametrize(("every", "far", "told_px"), [(3, 0.0, 0.5), (1, 0.3, 0.5), (1, 0.0, 2.0)])
def test_a_camera_is_as_uncertain_as_many_takes_of_it_scatter(every: int, far: float, told_px: float) -> None:
    """Where few corners must tell all, where some of them are far off, and where noise is less than was told."""
    rng, state = np.random.default_rng(0), a_still_state("plumb_bob")
    seen, noise = sightings_of(state, rng, noise=0.0), np.full(2, told_px)
    errors, covariances = [], []
    for _ in range(100):
        problem = BundleProblem(state, spoiled(seen, rng, far), FIXED)
        kept = problem.seen & (np.arange(len(BOARD.points)) % every == 0)
        look = minimise(problem, problem.look(state), kept, noise)
        errors.append(off_by(look.state.T_cam_rig[1], state.T_cam_rig[1]))
        covariances.append(problem.covariance(look, kept, noise)[problem.layout.camera(1), problem.layout.camera(1)])
    stated = np.mean(covariances, axis=0)
    squares = [error @ np.linalg.solve(stated, error) for error in errors]
    assert np.mean(squares) / 6 == pytest.approx(1.0, abs=0.2)


def bent_by(state: BundleState, sigma_m: float) -> BundleState:
    """A state whose board has its corners somewhere else."""
    rng = np.random.default_rng(0)
    return replace(state, points=state.points + rng.normal(0, sigma_m, state.points.shape))


@pytest.mark.parametrize("sigma_m", [0.003, 0.0001])
def test_corners_may_be_off_by_as_much_as_they_were_found_to_be_off(sigma_m: float) -> None:
    state = a_still_state("plumb_bob")
    problem = BundleProblem(
        state, sightings_of(state, np.random.default_rng(0)), BundleOptions(board=BoardFreedom.BENT)
    )
    problem.measure_board(bent_by(state, sigma_m))
    assert problem.tolerance == pytest.approx(sigma_m, rel=0.2)


def test_a_board_that_was_found_as_stated_is_still_no_better_than_a_print() -> None:
    state = a_still_state("plumb_bob")
    problem = BundleProblem(
        state, sightings_of(state, np.random.default_rng(0)), BundleOptions(board=BoardFreedom.BENT)
    )
    problem.measure_board(state)
    assert 1e-7 < problem.tolerance < 1e-4


def test_by_the_stamps_of_a_lone_camera_all_is_timed() -> None:
    """Nothing else says when its images were taken."""
    rng, two = np.random.default_rng(0), a_moving_state("plumb_bob")
    seen = [sighting for sighting in sightings_of(two, rng, noise=0.3) if sighting.camera == 0]
    state = replace(
        two,
        T_cam_rig=two.T_cam_rig[:1],
        lenses=two.lenses[:1],
        clocks=two.clocks[:1],
        readouts=two.readouts[:1],
        delays=np.zeros(len(seen)),
    )
    seen[5] = replace(seen[5], time_s=seen[5].time_s + 0.01)
    result = solve_bundle(state, seen, FIXED)
    assert not result.state.delays.any()
    assert not result.jitter_s.any()
    assert result.layout.clock(0).start == result.layout.clock(0).stop
