"""Boards from a short text (`charuco:5x7:0.04:0.03:DICT_5X5_100`) or a file: our YAML, Kalibr's, caliscope's TOML."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from twin_node.errors import reason
from twin_node.rig.calibrate.april_grid import AprilGrid
from twin_node.rig.calibrate.boards import Board, CharucoBoard, Chessboard, CircleGrid
from twin_node.rig.calibrate.intrinsics import MIN_CORNERS
from twin_node.rig.calibrate.markers import dictionary_of
from twin_node.rig.errors import RigError
from twin_node.rig.yaml_fields import Fields
from twin_node.yaml_file import read_yaml

FORMS = (
    "chessboard:COLUMNSxROWS:SQUARE (inner corners)",
    "charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY] (squares)",
    "aprilgrid:COLUMNSxROWS:TAG:GAP (gap as a share of the tag)",
    "circles:COLUMNSxROWS:SPACING",
    "acircles:COLUMNSxROWS:SPACING",
)
"""Boards as text; lengths in metres."""

NAMES = ("board.yaml", "board.yml", "board.toml", "charuco.toml", "target.yaml", "april.yaml")
"""What a board file in a folder of recordings may be called."""

INCH = 0.0254

LARGEST_M = 20.0
"""No board is longer: its lengths are in another unit."""

LEAST_ROWS, LEAST_DOTS = 4, 10
"""Of asymmetric circles: OpenCV finds no fewer in any image."""

MOST_CELLS = 10_000
"""No board has more corners: larger numbers are mistyped."""


def load_board(text: str) -> Board:
    """The board of a short text or of a file (`calibration/README.md` has the fields).

    Raises `RigError` where it is neither, or a field is wrong.
    """
    kind, _, rest = text.partition(":")
    if kind in _FROM_TEXT and rest:
        return _from_text(text, kind, rest.split(":"))
    path = Path(text)
    if not path.is_file():
        raise RigError(f"board {text!r}: expected a file or one of {'; '.join(FORMS)}; found neither")
    return _from_file(path)


def find_board(folder: Path) -> Board:
    """The board of the board file in a folder of recordings. Raises `RigError` where there is none."""
    if not folder.is_dir():
        found = "a file" if folder.exists() else "none"
        raise RigError(f"{folder}: expected a folder of recordings of a board, found {found}; check the path")
    for name in NAMES:
        if (folder / name).is_file():
            return _from_file(folder / name)
    raise RigError(f"{folder}: expected a board file ({', '.join(NAMES)}), found none; add one or give --board")


def _from_text(text: str, kind: str, parts: list[str]) -> Board:
    try:
        columns, rows = (int(part) for part in parts[0].split("x"))
        board = _FROM_TEXT[kind](columns, rows, parts[1:])
    except (ValueError, IndexError) as error:
        form = next(form for form in FORMS if form.startswith(f"{kind}:"))
        raise RigError(f"board {text!r}: expected {form}, found something else") from error
    return checked(f"board {text!r}", board)


def _text_chessboard(columns: int, rows: int, parts: list[str]) -> Board:
    (square,) = parts
    return Chessboard(columns, rows, float(square))


def _text_charuco(columns: int, rows: int, parts: list[str]) -> Board:
    square, marker, *dictionary = parts
    return CharucoBoard(columns, rows, float(square), float(marker), "".join(dictionary) or "DICT_4X4_50")


def _text_aprilgrid(columns: int, rows: int, parts: list[str]) -> Board:
    tag, gap = parts
    return AprilGrid(columns, rows, float(tag), float(gap))


def _text_circles(columns: int, rows: int, parts: list[str]) -> Board:
    (spacing,) = parts
    return CircleGrid(columns, rows, float(spacing))


def _text_acircles(columns: int, rows: int, parts: list[str]) -> Board:
    (spacing,) = parts
    return CircleGrid(columns, rows, float(spacing), asymmetric=True)


_FROM_TEXT: dict[str, Callable[[int, int, list[str]], Board]] = {
    "chessboard": _text_chessboard,
    "charuco": _text_charuco,
    "aprilgrid": _text_aprilgrid,
    "circles": _text_circles,
    "acircles": _text_acircles,
}


def _from_file(path: Path) -> Board:
    fields = Fields(
        str(path), _toml(path) if path.suffix == ".toml" else read_yaml(path, "a board file (YAML)", RigError)
    )
    if fields.has("target_type"):
        return checked(str(path), _kalibr(fields))
    if fields.has("aruco_scale"):
        return checked(str(path), _caliscope(fields))
    return checked(str(path), _own(fields))


def _toml(path: Path) -> object:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RigError(f"{path}: expected a board file (TOML), found {reason(error)}") from error


def _own(fields: Fields) -> Board:
    kind = fields.text("kind")
    columns, rows = whole(fields, "columns"), whole(fields, "rows")
    if kind == "chessboard":
        fields.only("kind", "columns", "rows", "square")
        return Chessboard(columns, rows, fields.number("square"))
    if kind == "charuco":
        fields.only("kind", "columns", "rows", "square", "marker", "dictionary", "inverted", "legacy")
        square, marker = fields.number("square"), fields.number("marker")
        dictionary = fields.text("dictionary", "DICT_4X4_50")
        return CharucoBoard(columns, rows, square, marker, dictionary, fields.flag("inverted"), fields.flag("legacy"))
    if kind == "aprilgrid":
        fields.only("kind", "columns", "rows", "tag", "gap", "dictionary")
        dictionary = fields.text("dictionary", "DICT_APRILTAG_36h11")
        return AprilGrid(columns, rows, fields.number("tag"), fields.number("gap"), dictionary)
    if kind in ("circles", "acircles"):
        fields.only("kind", "columns", "rows", "spacing")
        return CircleGrid(columns, rows, fields.number("spacing"), asymmetric=kind == "acircles")
    raise RigError(f"{fields.where}.kind: expected one of {', '.join(_FROM_TEXT)}, found {kind!r}")


def _kalibr(fields: Fields) -> Board:
    """A target file of Kalibr (github.com/ethz-asl/kalibr/wiki/calibration-targets)."""
    kind = fields.text("target_type")
    if kind == "aprilgrid":
        columns, rows = whole(fields, "tagCols"), whole(fields, "tagRows")
        return AprilGrid(columns, rows, fields.number("tagSize"), fields.number("tagSpacing"))
    columns, rows = whole(fields, "targetCols"), whole(fields, "targetRows")
    if kind == "checkerboard":
        square = fields.number("colSpacingMeters")
        if square != fields.number("rowSpacingMeters"):
            raise RigError(f"{fields.where}: expected square fields, found colSpacingMeters unlike rowSpacingMeters")
        return Chessboard(columns, rows, square)
    if kind == "circlegrid":
        return CircleGrid(columns, rows, fields.number("spacingMeters"), fields.flag("asymmetricGrid"))
    raise RigError(f"{fields.where}.target_type: expected aprilgrid, checkerboard or circlegrid, found {kind!r}")


def _caliscope(fields: Fields) -> Board:
    """`charuco.toml` of caliscope (github.com/mprib/caliscope), whose squares fill the page unless measured."""
    columns, rows = whole(fields, "columns"), whole(fields, "rows")
    if fields.has("square_size_override_cm"):
        square = fields.number("square_size_override_cm") / 100
    else:
        unit = INCH if fields.text("units") == "inch" else 0.01
        square = unit * min(fields.number("board_width") / columns, fields.number("board_height") / rows)
    dictionary = fields.text("dictionary")
    return CharucoBoard(
        columns, rows, square, square * fields.number("aruco_scale"), dictionary, fields.flag("inverted")
    )


def whole(fields: Fields, key: str) -> int:
    """A number of columns or rows. Raises `RigError` for what is none."""
    value = fields.number(key)
    if value < 2 or value % 1:
        raise RigError(f"{fields.where}.{key}: expected a whole number of 2 or more, found {value:g}")
    return int(value)


def checked(where: str, board: Board) -> Board:
    """The board, if there can be one.

    Raises `RigError` for lengths and markers that no board has, and for too few corners to be found or to tell a pose.
    """
    smallest = 3 if isinstance(board, Chessboard | CharucoBoard) else 2
    if min(board.columns, board.rows) < smallest:
        raise RigError(f"{where}: expected at least {smallest} columns and rows, found {board}")
    if board.columns * board.rows > MOST_CELLS:
        raise RigError(f"{where}: expected at most {MOST_CELLS} cells, found {board}")
    if isinstance(board, CharucoBoard) and not 0 < board.marker < board.square:
        raise RigError(f"{where}: expected markers smaller than squares, found {board}")
    if isinstance(board, CharucoBoard | AprilGrid):
        try:
            dictionary_of(board)
        except RigError as error:
            raise RigError(f"{where}: {error}") from None
    if not all(0 < length < np.inf for length in vars(board).values() if isinstance(length, float)):
        raise RigError(f"{where}: expected lengths above 0, found {board}")
    if len(board.points) < MIN_CORNERS:
        raise RigError(f"{where}: expected at least {MIN_CORNERS} corners, found {len(board.points)} of {board}")
    is_small = board.rows < LEAST_ROWS or len(board.points) < LEAST_DOTS
    if isinstance(board, CircleGrid) and board.asymmetric and is_small:
        raise RigError(f"{where}: expected at least {LEAST_ROWS} rows and {LEAST_DOTS} dots, found {board}")
    if float(board.points.max()) > LARGEST_M:
        raise RigError(
            f"{where}: expected lengths in metres, found {board}; if they are millimetres divide them by 1000"
        )
    return board
