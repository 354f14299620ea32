"""What a bundle leaves out of what was misread, what it keeps, and what noise it tells of each camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_bundle_adjustment import a_moving_state, a_still_state, sightings_of

from twin_node.geometry import inverse_pose, pose, transform
from twin_node.rig.calibrate.boards import Corners
from twin_node.rig.calibrate.bundle import BundleOptions, BundleResult, BundleState, Sighting
from twin_node.rig.calibrate.bundle_solver import board_pays, solve_bundle
from twin_node.rig.calibrate.lenses import project
from twin_node.scene import Float64

NOISE_PX = (0.1, 0.4)
FIXED = BundleOptions(lenses=False)


def off_by(sighting: Sighting, shifts: Float64) -> Sighting:
    """A sighting whose corners are shifted by [N, 2] pixels."""
    return replace(sighting, corners=Corners(sighting.corners.ids, sighting.corners.pixels + shifts))


def noisy(state: BundleState) -> list[Sighting]:
    """What two cameras see, one of them worse than the other."""
    rng = np.random.default_rng(1)
    return [
        off_by(s, rng.normal(0, NOISE_PX[s.camera], s.corners.pixels.shape)) for s in sightings_of(state, rng, noise=0)
    ]


def jolted(state: BundleState) -> BundleState:
    """A start beside the truth: the second camera half a degree and 5 mm off."""
    turn = pose(Rotation.from_rotvec([0.005, -0.005, 0.004]).as_matrix(), np.array([0.003, 0.003, -0.003]))
    return replace(state, T_cam_rig=np.stack([state.T_cam_rig[0], turn @ state.T_cam_rig[1]]))


@pytest.fixture(scope="module")
def misread() -> tuple[BundleState, list[Sighting], BundleResult]:
    """Truth, sightings and solution: of sighting 1 three corners are misread, of 4 and 9 most, of 6 the whole image."""
    state, rng = a_still_state("plumb_bob", sets=8), np.random.default_rng(3)
    seen = noisy(state)
    few, most = np.zeros((20, 2)), np.zeros((20, 2))
    few[[2, 7, 11]] = [[15, -12], [-9, 20], [30, 4]]
    most[:12] = rng.uniform(10, 40, (12, 2)) * rng.choice([-1, 1], (12, 2))
    seen[1] = off_by(seen[1], few)
    seen[4], seen[9] = off_by(seen[4], most), off_by(seen[9], most)
    seen[6] = replace(seen[6], corners=Corners(seen[6].corners.ids, seen[6].corners.pixels[::-1]))
    return state, seen, solve_bundle(jolted(state), seen, FIXED)


def test_misread_corners_go_and_the_rest_of_their_image_stays(
    misread: tuple[BundleState, list[Sighting], BundleResult],
) -> None:
    _, seen, result = misread
    assert [len(s.corners) for s in seen] == [20] * 16
    assert {id(s) for s in result.left_out} == {id(seen[4]), id(seen[6]), id(seen[9])}
    assert len(result.sightings) == len(result.residuals) == 13
    np.testing.assert_array_equal(result.sightings[1].corners.ids, np.delete(np.arange(20), [2, 7, 11]))
    np.testing.assert_array_equal(result.sightings[0].corners.pixels, seen[0].corners.pixels)
    counts = [17 if n == 1 else 0 if n in (4, 6, 9) else 20 for n in range(16)]
    np.testing.assert_array_equal(result.kept.sum(axis=1), counts)
    assert not result.kept[1, [2, 7, 11]].any()


def test_what_is_left_is_found_minus_projected_and_as_noisy_as_each_camera_is(
    misread: tuple[BundleState, list[Sighting], BundleResult],
) -> None:
    _, _, result = misread
    state = result.state
    for sighting, residual in zip(result.sightings, result.residuals, strict=True):
        placed = state.course.at(state.course.blend(np.array([sighting.board]), np.zeros(1)))
        corners = state.points[sighting.corners.ids] @ placed.rotations[0].T + placed.positions[0]
        seen = project(state.lenses[sighting.camera], transform(state.T_cam_rig[sighting.camera], corners)).pixels
        np.testing.assert_allclose(sighting.corners.pixels - seen, residual, atol=1e-6)
    np.testing.assert_allclose(result.noise_px, NOISE_PX, rtol=0.2)


def test_a_camera_stands_where_it_stood_within_what_is_stated(
    misread: tuple[BundleState, list[Sighting], BundleResult],
) -> None:
    truth, _, result = misread
    found = result.state.T_cam_rig[1]
    turn = Rotation.from_matrix(truth.T_cam_rig[1][:3, :3] @ found[:3, :3].T).as_rotvec()
    error = np.concatenate([turn, truth.T_cam_rig[1][:3, 3] - found[:3, 3]])
    covariance = result.covariance[result.layout.camera(1), result.layout.camera(1)]
    assert error @ np.linalg.solve(covariance, error) < 25  # 6 on average; one in 3000 is above
    assert np.linalg.norm(inverse_pose(truth.T_cam_rig[1])[:3, 3] - inverse_pose(found)[:3, 3]) < 0.003
    np.testing.assert_array_equal(result.state.T_cam_rig[0], truth.T_cam_rig[0])


@pytest.mark.parametrize("moving", [False, True])
def test_a_camera_of_which_no_image_fits_is_left_in_to_be_named(moving: bool) -> None:
    """Its images were left out, nothing held it any more, and the solver ended with a trace."""
    state, rng = a_moving_state("plumb_bob") if moving else a_still_state("plumb_bob", sets=8), np.random.default_rng(0)
    seen = sightings_of(state, rng)
    for n, sighting in enumerate(seen):
        if sighting.camera == 1:
            count = len(sighting.corners)
            shifts = np.zeros((count, 2))
            wrong = rng.permutation(count) < round(0.6 * count)
            shifts[wrong, 1] = (rng.uniform(20, 60, count) * rng.choice([-1, 1], count))[wrong]
            seen[n] = off_by(sighting, shifts)
    result = solve_bundle(state, seen, FIXED)
    of_second = [r for s, r in zip(result.sightings, result.residuals, strict=True) if s.camera == 1]
    assert np.isfinite(result.state.T_cam_rig).all()
    assert np.abs(np.concatenate(of_second)[:, 1]).max() > 10
    assert all(s.camera == 1 for s in result.left_out)


@pytest.mark.parametrize(
    ("shape", "price"),
    [
        (4, 4 / 2 * np.log(640)),  # what a sheet's numbers must explain, of 320 corners
        (60, 54 / 2 * np.log(640)),  # twenty corners, less where the board as a whole is
    ],
)
def test_a_board_of_another_shape_pays_from_schwarz_s_criterion_on(shape: int, price: float) -> None:
    state = a_still_state("plumb_bob", sets=8)
    seen = sightings_of(state, np.random.default_rng(0))
    one = solve_bundle(state, seen, FIXED)
    rng = np.random.default_rng(1)
    residuals = [0.1 * one.noise_px[s.camera] * rng.choice([-1, 1], (20, 2)) for s in seen]
    rigid = replace(one, sightings=tuple(seen), residuals=tuple(residuals))

    def pays(gain: float, cameras: tuple[int, ...]) -> bool:
        """Whether a board does that explains so much, in the images of some cameras."""
        share = np.exp(-gain / (320 * len(cameras)))  # each camera has 160 corners, of two numbers
        better = [r * share if s.camera in cameras else r for s, r in zip(seen, residuals, strict=True)]
        bent = replace(rigid, residuals=tuple(better), layout=replace(one.layout, shape=shape))
        return board_pays(rigid, bent)

    for cameras in ((0, 1), (0,), (1,)):
        assert pays(1.02 * price, cameras)
        assert not pays(0.98 * price, cameras)
