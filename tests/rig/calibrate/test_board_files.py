"""Files of boards, of our own and of other tools: which board each is, and what no board has."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin_node.rig import RigError
from twin_node.rig.calibrate.april_grid import AprilGrid
from twin_node.rig.calibrate.board_files import find_board
from twin_node.rig.calibrate.boards import Board, CharucoBoard, Chessboard, CircleGrid

SIZE = "columns: 6\nrows: 5\n"
CALISCOPE = (
    'columns = 4\nrows = 5\nboard_width = 8.5\nboard_height = 11.0\ndictionary = "DICT_4X4_50"\n'
    "inverted = true\naruco_scale = 0.75\n"
)


@pytest.mark.parametrize(
    ("name", "text", "board"),
    [
        ("board.yaml", f"kind: chessboard\n{SIZE}square: 0.03\n", Chessboard(6, 5, 0.03)),
        ("board.yml", f"kind: charuco\n{SIZE}square: 0.03\nmarker: 0.02\n", CharucoBoard(6, 5, 0.03, 0.02)),
        (
            "board.yaml",
            f"kind: charuco\n{SIZE}square: 0.03\nmarker: 0.02\ndictionary: DICT_5X5_50\ninverted: true\nlegacy: true\n",
            CharucoBoard(6, 5, 0.03, 0.02, "DICT_5X5_50", inverted=True, legacy=True),
        ),
        (
            "board.toml",
            'kind = "aprilgrid"\ncolumns = 2\nrows = 2\ntag = 0.06\ngap = 0.25\ndictionary = "DICT_APRILTAG_25h9"\n',
            AprilGrid(2, 2, 0.06, 0.25, "DICT_APRILTAG_25h9"),
        ),
        ("board.yaml", f"kind: circles\n{SIZE}spacing: 0.02\n", CircleGrid(6, 5, 0.02)),
        ("board.yaml", f"kind: acircles\n{SIZE}spacing: 0.02\n", CircleGrid(6, 5, 0.02, asymmetric=True)),
        (
            "target.yaml",
            "target_type: checkerboard\ntargetCols: 6\ntargetRows: 5\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n",
            Chessboard(6, 5, 0.06),
        ),
        (
            "target.yaml",
            "target_type: circlegrid\ntargetCols: 4\ntargetRows: 11\nspacingMeters: 0.02\nasymmetricGrid: true\n",
            CircleGrid(4, 11, 0.02, asymmetric=True),
        ),
        (
            "charuco.toml",
            f'{CALISCOPE}units = "inch"\n',
            CharucoBoard(4, 5, 8.5 / 4 * 0.0254, 0.75 * (8.5 / 4 * 0.0254), inverted=True),
        ),
        (
            "charuco.toml",
            f'{CALISCOPE}units = "cm"\n'.replace("11.0", "10.0"),
            CharucoBoard(4, 5, 0.02, 0.015, inverted=True),
        ),
        (
            "charuco.toml",
            f'{CALISCOPE}units = "inch"\nsquare_size_override_cm = 5.4\n',
            CharucoBoard(4, 5, 5.4 / 100, 0.75 * (5.4 / 100), inverted=True),
        ),
    ],
)
def test_files_of_every_kind_are_the_boards_that_they_say(tmp_path: Path, name: str, text: str, board: Board) -> None:
    (tmp_path / name).write_text(text)
    assert find_board(tmp_path) == board


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (f"kind: chessboard\n{SIZE}squares: 0.03\n", r"expected the field 'square'|found 'squares'"),
        (f"kind: chessboard\n{SIZE}square: 0.03\nmarker: 0.02\n", "found 'marker'; remove it"),
        (f"kind: charuco\n{SIZE}square: 0.03\nmarker: 0.02\ninvert: true\n", "found 'invert'; did you mean 'inverted'"),
        (f"kind: aprilgrid\n{SIZE}tag: 0.03\ngap: 0.3\nspacing: 0.3\n", "found 'spacing'"),
        (f"kind: circles\n{SIZE}spacing: 0.03\nsquare: 0.3\n", "found 'square'"),
        (
            f"kind: charuco\n{SIZE}square: 0.03\nmarker: 0.02\ndictionary: DICT_9X9\n",
            "marker dictionary: .* 'DICT_9X9'",
        ),
        ("kind: charuco\ncolumns: 30\nrows: 30\nsquare: 0.03\nmarker: 0.02\n", "expected at most 50 markers"),
        (f"kind: chess\n{SIZE}square: 0.03\n", r"kind: expected one of chessboard, .*, found 'chess'"),
        ("kind: chessboard\ncolumns: 6.5\nrows: 5\nsquare: 0.03\n", "columns: expected a whole number of 2 or more"),
        ("kind: circles\ncolumns: 1\nrows: 5\nspacing: 0.03\n", "columns: expected a whole number of 2 or more"),
        ("kind: chessboard\ncolumns: 6\nrows: 2\nsquare: 0.03\n", "expected at least 3 columns and rows"),
        ("target_type: april\ntargetCols: 6\ntargetRows: 5\n", "target_type: expected aprilgrid, checkerboard or"),
        (
            "target_type: checkerboard\ntargetCols: 6\ntargetRows: 5\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.05\n",
            "expected square fields",
        ),
    ],
)
def test_what_no_board_file_holds_is_named(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "board.yaml").write_text(text)
    with pytest.raises(RigError, match=rf"board\.yaml.*({told})"):
        find_board(tmp_path)


@pytest.mark.parametrize(("columns", "told"), [(5000 * "9", "digits"), (5000 * "[", "too many levels")])
def test_what_toml_cannot_hold_is_one_error(tmp_path: Path, columns: str, told: str) -> None:
    (tmp_path / "charuco.toml").write_text(f"columns = {columns}\n")
    with pytest.raises(RigError, match=rf"charuco\.toml: expected a board file \(TOML\), found .*{told}"):
        find_board(tmp_path)


def test_a_place_without_a_board_file_is_named(tmp_path: Path) -> None:
    for place, found in ((tmp_path / "none", "found none"), (Path(__file__), "found a file")):
        with pytest.raises(RigError, match=rf"expected a folder of recordings of a board, {found}"):
            find_board(place)
