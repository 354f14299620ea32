"""One lens from made-up views: found where the views tell it, refused where they leave it open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_boards import a_lens

from twin_node.geometry import pose, transform
from twin_node.rig import RigError
from twin_node.rig.calibrate.boards import CharucoBoard, Corners
from twin_node.rig.calibrate.intrinsics import BoardView, calibrate_lens
from twin_node.rig.calibrate.lenses import Lens, in_view, pixel_rays, project
from twin_node.rig.calibrate.normal_equations import NormalEquations
from twin_node.scene import Float64

BOARD = CharucoBoard(9, 7, 0.04, 0.03)


def views_of(
    lens: Lens, count: int, tilt: float, rng: np.random.Generator, noise_px: float = 0.3, bow_m: float = 0.0
) -> list[BoardView]:
    """Boards all over the image, tilted by so much, rad (1 sigma, both ways); bowed by so much along x, m."""
    views: list[BoardView] = []
    size, centre = np.array([lens.width, lens.height]), BOARD.points.mean(axis=0)
    x = BOARD.points[:, 0] - centre[0]
    points = BOARD.points + bow_m * np.outer((x / x.max()) ** 2, [0.0, 0.0, 1.0])
    while len(views) < count:
        ray = pixel_rays(lens, rng.uniform(0.1 * size, 0.9 * size)[None])[0]
        R = Rotation.from_rotvec([*rng.normal(0, tilt, 2), rng.normal(0, 0.5)]).as_matrix()
        places = transform(pose(R, rng.uniform(0.4, 1.2) * np.array([*ray, 1.0]) - R @ centre), points)
        pixels = project(lens, places).pixels
        inside = ((pixels > 3) & (pixels < size - 4)).all(axis=1) & (places[:, 2] > 0.1)
        if inside.sum() > 11:
            found = pixels[inside] + rng.normal(0, noise_px, (int(inside.sum()), 2))
            views.append(BoardView(f"{len(views)}.png", Corners(np.flatnonzero(inside), found)))
    return views


def off_px(lens: Lens, truth: Lens) -> Float64:
    """Between where both see what the true one sees all over its image but for the rim, without what all share: a
    small turn."""
    u, v = np.meshgrid(np.linspace(60, truth.width - 60, 16), np.linspace(60, truth.height - 60, 12))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = np.concatenate([pixel_rays(truth, pixels), np.ones((len(pixels), 1))], axis=1)
    off = project(lens, rays).pixels - pixels
    return np.asarray(np.linalg.norm(off - off.mean(axis=0), axis=1))


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial", "equidistant"])
@pytest.mark.parametrize("seed", [0, 1])
def test_every_model_is_found_and_its_stated_errors_hold(model: str, seed: int) -> None:
    truth = a_lens(model, 1280, 720, 600.0 if model == "equidistant" else 900.0)
    calibration = calibrate_lens(BOARD, views_of(truth, 12, 0.5, np.random.default_rng(seed)), (1280, 720), model)
    z = (calibration.lens.parameters - truth.parameters) / calibration.sigmas
    assert np.abs(z).max() < 4
    assert calibration.sigmas[0] < 0.01 * truth.K[0, 0]
    assert np.abs(calibration.lens.D).max() < 5
    assert np.median(off_px(calibration.lens, truth)) < 3


def test_a_fisheye_that_sees_all_around_is_found() -> None:
    """OpenCV's own start gave these pictures up."""
    truth = a_lens("equidistant", 1280, 720, 400.0)
    views = views_of(truth, 8, 0.5, np.random.default_rng(1))
    calibration = calibrate_lens(BOARD, views, (1280, 720), truth.distortion_model)
    assert np.abs((calibration.lens.parameters - truth.parameters) / calibration.sigmas).max() < 4


@pytest.mark.parametrize("bow_mm", [2.0, 8.0])
def test_a_board_that_is_not_flat_leaves_the_lens_as_it_is(bow_mm: float) -> None:
    """Taken for flat, or for corners each somewhere else, it gave focal lengths 16 and 63 px off, 3 and 6 px stated."""
    truth = a_lens("plumb_bob", 1280, 720, 900.0)
    views = views_of(truth, 12, 0.5, np.random.default_rng(0), bow_m=1e-3 * bow_mm)
    calibration = calibrate_lens(BOARD, views, (1280, 720))
    assert np.abs((calibration.lens.parameters - truth.parameters) / calibration.sigmas).max() < 4
    assert calibration.sigmas[0] < 0.005 * truth.K[0, 0]
    x = BOARD.points[:, 0] - BOARD.points[:, 0].mean()
    assert calibration.board.off_m == pytest.approx(1e-3 * bow_mm * np.std((x / x.max()) ** 2), rel=0.1)


@pytest.mark.parametrize("bow_mm", [0.0, 8.0])
def test_corners_that_no_picture_shows_are_no_matter(bow_mm: float) -> None:
    """Of a board whose corner was cut off, or hidden by a hand, in all pictures calibrating ended in a trace."""
    truth = a_lens("plumb_bob", 1280, 720, 900.0)
    views = views_of(truth, 12, 0.5, np.random.default_rng(3), bow_m=bow_mm / 1e3)
    shown = [replace(view, corners=view.corners.chosen(~np.isin(view.corners.ids, [0, 7, 47]))) for view in views]
    calibration = calibrate_lens(BOARD, shown, (1280, 720))
    assert np.median(off_px(calibration.lens, truth)) < 3


def test_boards_that_hardly_tilt_leave_the_focal_length_open() -> None:
    """The wrong one that fits best was once stated to a tenth of a pixel."""
    views = views_of(a_lens("plumb_bob", 1280, 720, 900.0), 5, 0.01, np.random.default_rng(0))
    with pytest.raises(RigError, match=r"focal length told to 10 %, found \d+ \+- \d+ px: the views leave it open"):
        calibrate_lens(BOARD, views, (1280, 720))


def test_a_picture_that_is_given_again_and_again_is_one_witness() -> None:
    lens = a_lens()
    views = views_of(lens, 6, 0.5, np.random.default_rng(1))
    once = calibrate_lens(BOARD, views, (640, 480))
    thrice = [BoardView(f"{name}{view.name}", view.corners) for name in ("", "copy of ", "another ") for view in views]
    again = calibrate_lens(BOARD, thrice, (640, 480))
    np.testing.assert_allclose(again.sigmas, once.sigmas)
    assert next((view.name, view.reason) for view in again.dropped) == ("copy of 0.png", "the same picture as 0.png")
    with pytest.raises(RigError, match="expected at least 3 views of the board"):
        calibrate_lens(BOARD, [views[0]] * 5, (640, 480))


def test_what_nothing_tells_has_a_large_variance_and_not_none() -> None:
    equations, J = NormalEquations(6, 5, 3), np.zeros((30, 9))
    J[:, :8] = np.random.default_rng(0).normal(size=(30, 8))
    J[:, 8] = J[:, 7] * (1 + 1e-9)
    equations.add_inner(np.arange(6)[None], (J[:, :6].T @ J[:, :6])[None], np.zeros((1, 6)))
    equations.add_mixed(np.arange(6)[None], np.arange(3), (J[:, :6].T @ J[:, 6:])[None])
    equations.add_outer(np.arange(3), J[:, 6:].T @ J[:, 6:], np.zeros(3))
    assert (np.diag(equations.outer_covariance())[1:] > 1e6).all()


def test_what_a_distortion_folds_back_into_the_image_is_not_in_view() -> None:
    lens = Lens(
        640, 480, np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]]), "plumb_bob", np.array([-0.35] + 4 * [0])
    )
    points = np.array([[0.0, 0, 1], [0.4, 0.2, 1], [1.6, 0.1, 1], [0.9, 0, 1], [0.1, 0, -1]])
    assert np.abs(project(lens, points).pixels[2] - [320, 240]).max() < 200  # well inside the image
    assert in_view(lens, points).tolist() == [True, True, False, False, False]
