"""Boards as pages to print at true scale: PDF, SVG or PNG."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from functools import singledispatch
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from twin_node.rig.calibrate.april_grid import AprilGrid
from twin_node.rig.calibrate.boards import Board, CharucoBoard, Chessboard, CircleGrid
from twin_node.rig.calibrate.markers import dictionary_of
from twin_node.rig.errors import RigError
from twin_node.scene import Float64, UInt8
from twin_node.unfinished import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMATS = (".pdf", ".svg", ".png")
INCH_M, DPI = 0.0254, 300
"""Resolution of PNG files, dots per inch: what office printers print."""
MOST_PIXELS = 500e6
"""Of a PNG file: a page two metres wide and high; half as wide again would take all memory of a small computer."""
CAPTION_M = 0.014
"""Height of the strip below the board that says what it is and shows a bar to measure."""
BAR_M = 0.1
"""Length of the bar: what the page must measure before it is used."""
DOT_SHARE = 0.25
"""Radius of a dot as a share of the spacing, as OpenCV's pattern generator draws them."""
TAG_BORDER = 2
"""Modules of a Kalibr tag's black frame; a plain tag's is one wide."""
PAPERS_M = {"A4": (0.21, 0.297), "A3": (0.297, 0.42), "A2": (0.42, 0.594), "A1": (0.594, 0.841), "A0": (0.841, 1.189)}


@dataclass(frozen=True)
class Tile:
    """A marker: black and white modules in a square."""

    corner: tuple[float, float]
    """Its upper left corner, m from that of the board."""
    edge: float
    """m."""
    modules: UInt8
    """[n, n] 0 black, 255 white."""


@dataclass(frozen=True)
class BoardPrint:
    """What is black on a board, in metres from its upper left corner, y down."""

    width: float
    height: float
    margin: float
    """White around it that detectors need; dark of inverted boards."""
    squares: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    """[n, 3] x, y of the upper left corner, and edge."""
    dots: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    """[n, 3] x, y of the centre, and radius."""
    tiles: tuple[Tile, ...] = ()
    inverted: bool = False
    """Light on dark."""

    @property
    def page_m(self) -> tuple[float, float]:
        """Width and height of the page, m: margins and caption included."""
        return max(self.width + 2 * self.margin, BAR_M + 2 * CAPTION_M), self.height + 2 * self.margin + CAPTION_M

    @property
    def paper(self) -> str:
        """The smallest customary paper that it fits on."""
        page = sorted(self.page_m)
        fitting = (name for name, size in PAPERS_M.items() if page[0] <= size[0] and page[1] <= size[1])
        return next(fitting, "larger than A0: let it be printed on a panel")


@singledispatch
def draw_board(board: Board) -> BoardPrint:
    """What to print of a board. Raises `RigError` for a kind that has no drawing."""
    raise RigError(f"{board}: expected a chessboard, charuco, aprilgrid or circles, found another kind of board")


@draw_board.register
def _(board: Chessboard) -> BoardPrint:
    rows, columns = board.rows + 1, board.columns + 1
    return BoardPrint(columns * board.square, rows * board.square, board.square, _dark(rows, columns, board.square, 0))


@draw_board.register
def _(board: CharucoBoard) -> BoardPrint:
    legacy = board.legacy and board.rows % 2 == 0
    squares = _dark(board.rows, board.columns, board.square, int(legacy))
    light = [(i, j) for i in range(board.rows) for j in range(board.columns) if (i + j) % 2 != int(legacy)]
    dictionary, inset = dictionary_of(board), (board.square - board.marker) / 2
    side = dictionary.markerSize + 2
    tiles = tuple(
        Tile((j * board.square + inset, i * board.square + inset), board.marker, _marker(dictionary, number, side, 1))
        for number, (i, j) in enumerate(light)
    )
    size = (board.columns * board.square, board.rows * board.square)
    return BoardPrint(*size, board.square / 2, squares, tiles=tiles, inverted=board.inverted)


@draw_board.register
def _(board: AprilGrid) -> BoardPrint:
    gap, step = board.tag * board.spacing, board.tag * (1 + board.spacing)
    height = board.rows * step + gap
    dictionary = dictionary_of(board)
    side = dictionary.markerSize + 2 * TAG_BORDER
    tiles = tuple(
        Tile(
            (gap + column * step, height - (row + 1) * step),
            board.tag,
            _marker(dictionary, row * board.columns + column, side, TAG_BORDER),
        )
        for row in range(board.rows)
        for column in range(board.columns)
    )
    between = [(j * step, i * step, gap) for i in range(board.rows + 1) for j in range(board.columns + 1)]
    return BoardPrint(board.columns * step + gap, height, gap, np.array(between), tiles=tiles)


@draw_board.register
def _(board: CircleGrid) -> BoardPrint:
    centres = board.points[:, :2] + board.spacing / 2
    width, height = (centres.max(axis=0) + board.spacing / 2).tolist()
    dots = np.column_stack([centres, np.full(len(centres), DOT_SHARE * board.spacing)])
    return BoardPrint(width, height, board.spacing / 2, dots=dots)


def print_board(board: Board, path: Path) -> BoardPrint:
    """Writes a board at true scale to a `.pdf`, `.svg` or `.png` file.

    Raises `RigError` for another suffix, a folder that does not exist, a board without a drawing, or one that is too
    large for pixels.
    """
    if path.suffix.lower() not in FORMATS:
        raise RigError(f"{path}: expected a name ending in {', '.join(FORMATS)}, found {path.suffix or 'no suffix'!r}")
    if not path.parent.is_dir():
        raise RigError(f"{path}: folder {path.parent} does not exist; create it first")
    drawing = draw_board(board)
    width, height = drawing.page_m
    form = path.suffix.lower()
    if form == ".png" and width * height * (DPI / INCH_M) ** 2 > MOST_PIXELS:
        raise RigError(
            f"{path}: expected a page of at most {MOST_PIXELS / 1e6:.0f} million pixels at {DPI} dpi, found one of "
            f"{1000 * width:.0f} x {1000 * height:.0f} mm; write a .pdf or .svg, which have none"
        )
    import matplotlib as mpl
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / INCH_M, height / INCH_M))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    _draw(axes, drawing)
    _caption(axes, board, drawing)
    page = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "board", "svg.fonttype": "none"}):
        figure.savefig(page, format=form[1:], dpi=DPI, metadata=_UNDATED.get(form))
    with whole_file(path, RigError) as partial:  # on a full disk Matplotlib would trip over its own PDF
        partial.write_bytes(page.getvalue())  # of its buffer in an error Python 3.12.1 crashes (issue 111049)
    return drawing


_UNDATED: dict[str, dict[str, str | None]] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
"""The same board gives the same file."""


def _draw(axes: Axes, drawing: BoardPrint) -> None:
    from matplotlib.patches import Circle, Rectangle

    dark, light = ("white", "black") if drawing.inverted else ("black", "white")
    margin = drawing.margin
    whole = (drawing.width + 2 * margin, drawing.height + 2 * margin)
    axes.add_patch(Rectangle((0, 0), *whole, facecolor=light, linewidth=0))
    for x, y, edge in drawing.squares:
        axes.add_patch(Rectangle((margin + x, margin + y), edge, edge, facecolor=dark, linewidth=0))
    for x, y, radius in drawing.dots:
        axes.add_patch(Circle((margin + x, margin + y), radius, facecolor=dark, linewidth=0))
    for tile in drawing.tiles:
        x, y = margin + tile.corner[0], margin + tile.corner[1]
        modules = 255 - tile.modules if drawing.inverted else tile.modules
        extent = (x, x + tile.edge, y + tile.edge, y)
        axes.imshow(
            modules, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="none", aspect="auto", zorder=2
        )
    axes.set(xlim=(0, drawing.page_m[0]), ylim=(drawing.page_m[1], 0))


def _caption(axes: Axes, board: Board, drawing: BoardPrint) -> None:
    from matplotlib.patches import Rectangle

    top = drawing.height + 2 * drawing.margin
    axes.add_patch(Rectangle((CAPTION_M / 2, top + 0.004), BAR_M, 0.001, facecolor="black", linewidth=0))
    text = f"{board}. Print at 100 %: the bar is {1000 * BAR_M:.0f} mm long; else measure a square."
    axes.text(CAPTION_M / 2, top + 0.011, text, fontsize=6, family="sans-serif")


def _dark(rows: int, columns: int, square: float, first: int) -> Float64:
    """[n, 3] the dark squares of a chessboard whose upper left square is dark where `first` is 0."""
    dark = [(j * square, i * square, square) for i in range(rows) for j in range(columns) if (i + j) % 2 == first]
    return np.array(dark)


def _marker(dictionary: cv2.aruco.Dictionary, number: int, side: int, border: int) -> UInt8:
    """[side, side] a marker's modules."""
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, number, side, borderBits=border), np.uint8)
