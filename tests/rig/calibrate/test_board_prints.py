"""Boards that are printed are found again where they were drawn, at true scale."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from twin_node.cli import main
from twin_node.rig import RigError
from twin_node.rig.calibrate.april_grid import AprilGrid
from twin_node.rig.calibrate.board_prints import DPI, INCH_M, draw_board, print_board
from twin_node.rig.calibrate.boards import Board, CharucoBoard, Chessboard, CircleGrid

BOARDS: list[Board] = [
    Chessboard(6, 5, 0.02),
    CharucoBoard(6, 5, 0.025, 0.018),
    CharucoBoard(5, 7, 0.02, 0.015, "DICT_5X5_100", inverted=True),
    CharucoBoard(5, 6, 0.025, 0.018, legacy=True),
    CharucoBoard(6, 5, 0.025, 0.018, legacy=True),
    AprilGrid(4, 3, 0.03, 0.3),
    CircleGrid(7, 6, 0.02),
    CircleGrid(4, 7, 0.02, asymmetric=True),
]


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_a_printed_board_is_detected_at_true_scale(board: Board, tmp_path: Path) -> None:
    drawing = print_board(board, tmp_path / "board.png")
    picture = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    assert abs(picture.shape[1] * INCH_M / DPI - drawing.page_m[0]) < 2 * INCH_M / DPI
    small = cv2.resize(picture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    found = board.detect(cv2.copyMakeBorder(small, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=(200,)))
    assert found is not None
    assert len(found) == len(board.points)
    places = found.pixels * 4 * INCH_M / DPI
    expected = board.points[found.ids, :2]
    turn, error = _aligned(expected, places)
    assert error < 2e-4
    assert np.linalg.det(turn) == pytest.approx(-1 if isinstance(board, AprilGrid) else 1, abs=0.02)  # y up, or down


def _aligned(points: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, float]:
    """The linear map from board points to page places, and the largest distance that it leaves, m."""
    a, b = points - points.mean(axis=0), places - places.mean(axis=0)
    turn = np.linalg.lstsq(a, b, rcond=None)[0]
    return turn, float(np.abs(a @ turn - b).max())


def test_pages_are_the_same_every_time_and_tell_their_paper(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a.pdf", "b.pdf", "a.svg", "b.svg"):
        assert main(["calibrate", "board", "charuco:6x5:0.03:0.022:DICT_4X4_50", "-o", str(tmp_path / name)]) == 0
    assert "(A4)" in capsys.readouterr().out
    for kind in ("pdf", "svg"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()


def test_what_cannot_be_printed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"ending in \.pdf"):
        print_board(BOARDS[0], tmp_path / "board.docx")
    with pytest.raises(RigError, match=r"500 million pixels .* 20400 x 20414 mm; write a \.pdf or \.svg"):
        print_board(Chessboard(99, 99, 0.2), tmp_path / "board.png")  # it took all memory
    with pytest.raises(RigError, match="does not exist"):
        print_board(BOARDS[0], tmp_path / "nowhere" / "board.pdf")
    with pytest.raises(RigError, match="at most 50 markers"):
        print_board(CharucoBoard(12, 12, 0.02, 0.015), tmp_path / "board.pdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("board", "paper"),
    [
        (Chessboard(5, 4, 0.02), "A4"),
        (Chessboard(9, 9, 0.02), "A3"),
        (Chessboard(3, 29, 0.02), "A1"),
        (Chessboard(29, 3, 0.02), "A1"),
        (Chessboard(15, 15, 0.022), "A2"),
        (Chessboard(15, 15, 0.042), "A0"),
        (Chessboard(30, 30, 0.05), "larger than A0: let it be printed on a panel"),
    ],
    ids=str,
)
def test_the_paper_is_the_smallest_that_both_sides_fit_on(board: Board, paper: str) -> None:
    assert draw_board(board).paper == paper


def test_a_small_boards_page_has_room_for_the_bar_that_is_to_be_measured() -> None:
    width, height = draw_board(Chessboard(3, 3, 0.005)).page_m
    assert width == pytest.approx(0.1 + 2 * 0.014)
    assert height == pytest.approx(0.02 + 2 * 0.005 + 0.014)


@pytest.mark.parametrize("board", [BOARDS[0], BOARDS[2], Chessboard(3, 3, 0.005)], ids=str)
def test_the_bar_on_the_page_is_as_long_as_the_page_says(board: Board, tmp_path: Path) -> None:
    drawing = print_board(board, tmp_path / "board.png")
    picture = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    below = round((drawing.height + 2 * drawing.margin + 0.0045) * DPI / INCH_M)
    dark = np.flatnonzero(picture[below] < 128)
    assert len(dark) == dark[-1] - dark[0] + 1
    assert len(dark) * INCH_M / DPI == pytest.approx(0.1, abs=2 * INCH_M / DPI)


@pytest.mark.parametrize("board", [BOARDS[0], BOARDS[3]], ids=str)
def test_a_page_to_print_has_its_size_in_its_file(board: Board, tmp_path: Path) -> None:
    width, height = print_board(board, tmp_path / "board.svg").page_m
    print_board(board, tmp_path / "board.pdf")
    in_points = (width / INCH_M * 72, height / INCH_M * 72)
    told = re.search(rb'width="([0-9.]+)pt" height="([0-9.]+)pt"', (tmp_path / "board.svg").read_bytes())
    box = re.search(rb"/MediaBox \[ 0 0 ([0-9.]+) ([0-9.]+) \]", (tmp_path / "board.pdf").read_bytes())
    for found in (told, box):
        assert found is not None
        np.testing.assert_allclose([float(n) for n in found.groups()], in_points, atol=0.01)


def test_a_page_that_does_not_fit_is_one_error(tmp_path: Path) -> None:
    """Matplotlib ended in an error of its own while it closed half a PDF."""
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_ROOM, str(tmp_path)], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.splitlines() == [
        f"{tmp_path / name}: cannot be written (File too large); free space or choose another place"
        for name in ("board.pdf", "board.svg", "board.png")
    ]
    assert not list(tmp_path.iterdir())


WITHOUT_ROOM = """
import resource, signal, sys
from pathlib import Path
from twin_node.rig import RigError
from twin_node.rig.calibrate.board_prints import print_board
from twin_node.rig.calibrate.boards import CircleGrid
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
print_board(CircleGrid(2, 3, 0.03), Path(sys.argv[1]) / "first.png")  # Matplotlib writes a cache of fonts
(Path(sys.argv[1]) / "first.png").unlink()
resource.setrlimit(resource.RLIMIT_FSIZE, (1024, resource.RLIM_INFINITY))
for suffix in (".pdf", ".svg", ".png"):
    try:
        print_board(CircleGrid(2, 3, 0.03), Path(sys.argv[1]) / f"board{suffix}")
    except RigError as error:
        print(error)
"""
