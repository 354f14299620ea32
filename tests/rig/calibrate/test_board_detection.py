"""Boards in pictures: every kind's corners are found where they are, in the order that the board has once."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_boards import a_lens, picture, seen_corners

from twin_node.geometry import pose
from twin_node.rig import RigError
from twin_node.rig.calibrate.april_grid import AprilGrid
from twin_node.rig.calibrate.boards import SEARCH_PX, Board, CharucoBoard, Chessboard, CircleGrid
from twin_node.scene import Float64

BOARDS: dict[str, Board] = {
    "chessboard": Chessboard(8, 5, 0.03),
    "charuco": CharucoBoard(7, 5, 0.04, 0.03, "DICT_5X5_100"),
    "inverted charuco": CharucoBoard(7, 5, 0.04, 0.03, "DICT_5X5_100", inverted=True),
    "aprilgrid": AprilGrid(4, 3, 0.06, 0.3),
    "circles": CircleGrid(7, 6, 0.03),
    "asymmetric circles": CircleGrid(4, 11, 0.02, asymmetric=True),
}


def before_camera(board: Board, turn: float = 0.0) -> Float64:
    """`T_cam_board` that shows the whole board, tilted, `turn` rad about the axis of the camera."""
    up = np.diag([1.0, -1.0, -1.0]) if isinstance(board, AprilGrid) else np.eye(3)
    tilt = Rotation.from_euler("zyx", [turn, 0.35, -0.25]).as_matrix() @ up
    middle = (board.points.max(axis=0) + board.points.min(axis=0)) / 2
    distance = 1.9 * float(np.ptp(board.points[:, :2], axis=0).max())
    return pose(tilt, np.array([0.01, -0.01, distance]) - tilt @ middle)


@pytest.mark.parametrize("kind", BOARDS)
def test_corners_are_found_where_they_are(kind: str) -> None:
    board, lens = BOARDS[kind], a_lens()
    T = before_camera(board)
    found, truth = board.detect(picture(board, lens, T)), seen_corners(board, lens, T)
    assert found is not None and truth is not None
    assert len(found) == len(board.points) == len(truth)
    expected = truth.pixels[found.ids]
    assert np.abs(found.pixels - expected).max() < 0.35  # centres of dots move with perspective and distortion
    assert np.abs(found.pixels - expected).mean() < 0.12


def test_a_chessboard_in_a_large_image_is_looked_for_in_a_smaller_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A board that was half hidden took over a minute in one 3840 pixels wide."""
    board, lens = BOARDS["chessboard"], a_lens(width=2600, height=1950, focal=2112.5)
    T, sizes, find = before_camera(board), list[int](), cv2.findChessboardCorners

    def watched(image: Any, size: tuple[int, int]) -> Any:
        sizes.append(max(image.shape))
        return find(image, size)

    monkeypatch.setattr(cv2, "findChessboardCorners", watched)
    found, truth = board.detect(picture(board, lens, T)), seen_corners(board, lens, T)
    assert found is not None and truth is not None
    assert sizes == [SEARCH_PX]
    assert np.abs(found.pixels - truth.pixels[found.ids]).max() < 0.35
    assert np.abs(found.pixels - truth.pixels[found.ids]).mean() < 0.12


@pytest.mark.parametrize("kind", ["chessboard", "charuco", "aprilgrid", "asymmetric circles"])
def test_a_turned_board_keeps_its_numbers(kind: str) -> None:
    board, lens = BOARDS[kind], a_lens()
    assert board.turns == 1
    for turn in (np.pi / 2, np.pi, 3.0 * np.pi / 2):
        T = before_camera(board, turn)
        found, truth = board.detect(picture(board, lens, T)), seen_corners(board, lens, T)
        assert found is not None and truth is not None
        place = {int(i): pixel for i, pixel in zip(truth.ids, truth.pixels, strict=True)}
        errors = [np.linalg.norm(p - place[int(i)]) for i, p in zip(found.ids, found.pixels, strict=True)]
        assert len(errors) >= 0.7 * len(board.points)
        assert max(errors) < 0.5


def test_boards_that_look_the_same_when_turned_say_so() -> None:
    assert Chessboard(8, 6, 0.03).turns == 2
    for board in (CircleGrid(7, 6, 0.03), *(CircleGrid(4, rows, 0.02, asymmetric=True) for rows in (10, 11))):
        dots = board.points[:, :2]
        turned = dots.min(axis=0) + dots.max(axis=0) - dots
        is_same = np.linalg.norm(turned[:, None] - dots, axis=2).min(axis=1).max() < 1e-9
        assert board.turns == (2 if is_same else 1), board


@pytest.mark.parametrize("kind", BOARDS)
def test_a_picture_without_a_board_has_no_corners(kind: str) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (240, 320)).astype(np.uint8)
    assert BOARDS[kind].detect(cv2.GaussianBlur(noise, (0, 0), 3).astype(np.uint8)) is None


@pytest.mark.parametrize("kind", BOARDS)
@pytest.mark.parametrize("shape", [(1, 1), (14, 60), (60, 14), (20, 4000)])
def test_a_picture_too_small_for_any_board_has_no_corners(kind: str, shape: tuple[int, int]) -> None:
    """One of a few pixels ended in a trace of OpenCV's."""
    assert BOARDS[kind].detect(np.zeros(shape, np.uint8)) is None


def test_an_unknown_dictionary_is_refused() -> None:
    with pytest.raises(RigError, match="DICT_9X9"):
        CharucoBoard(5, 4, 0.04, 0.03, "DICT_9X9").detect(np.zeros((100, 100), np.uint8))


@pytest.mark.parametrize("blur_px", [0.0, 1.0])
@pytest.mark.parametrize("view", ["steep", "half out of the picture", "far"])
def test_an_aprilgrid_is_read_steep_blurred_and_in_part(view: str, blur_px: float) -> None:
    board, lens = AprilGrid(5, 4, 0.06, 0.3), a_lens()
    T = before_camera(board)
    if view == "steep":
        T[:3, :3] = Rotation.from_euler("y", 0.5).as_matrix() @ T[:3, :3]
    T[0, 3] += {"steep": 0.1, "half out of the picture": 0.25, "far": 0.0}[view]
    T[2, 3] += 0.2 if view == "far" else 0.0
    image, truth = picture(board, lens, T), seen_corners(board, lens, T)
    if blur_px:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8)
    found = board.detect(image)
    assert found is not None and truth is not None
    place = {int(i): pixel for i, pixel in zip(truth.ids, truth.pixels, strict=True)}
    errors = [
        np.linalg.norm(p - place[int(i)]) for i, p in zip(found.ids, found.pixels, strict=True) if int(i) in place
    ]
    assert len(errors) >= 24
    assert np.median(errors) < 0.1
    assert np.quantile(errors, 0.95) < 0.5  # a stray corner is the adjustment's to leave out
    assert len(found) < len(board.points) or view != "half out of the picture"


@pytest.mark.parametrize("board", [AprilGrid(3, 2, 0.06, 0.2), CircleGrid(3, 5, 0.05, asymmetric=True)], ids=str)
def test_a_board_that_fills_a_large_image_is_found_where_it_is(board: Board) -> None:
    """The frames of its tags are wide, its dots large: a detector's customary limits are those of small images."""
    lens = a_lens(width=2560, height=1920, focal=2080.0)
    T = before_camera(board)
    found, truth = board.detect(picture(board, lens, T)), seen_corners(board, lens, T)
    assert found is not None and truth is not None
    assert len(found) == len(board.points) == len(truth)
    assert np.abs(found.pixels - truth.pixels).max() < 1.0
