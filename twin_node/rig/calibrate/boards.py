"""Calibration targets: where their corners are, and the corners found in an image (OpenCV's detectors)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.markers import marker_dictionary
from twin_node.scene import Bool, Float64, UInt8

REFINE_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
"""Sub-pixel refinement ends after 60 rounds or below 1e-4 pixels: far under the 0.05 that corners are good for."""

REFINE_SHARE = 0.35
"""Half of the refinement window as a share of the distance to the next corner: a window that reaches the neighbours'
edges is biased (on 640x480 pictures of a chessboard 11 pixels gave twice the residual of 5)."""

REFINE_LIMITS = (2, 11)
"""Smallest and largest half window, pixels: below it noise rules, above it the window adds blur, not evidence."""

SEARCH_PX = 1920
"""Longest side of the images that a chessboard is looked for in: one that is half hidden takes OpenCV 4 s there, and 80
in one twice as wide."""

SMALLEST_PX = 15
"""Least side of an image that OpenCV looks for a chessboard in; in smaller ones, which show none, it raises."""


@dataclass(frozen=True)
class Corners:
    """Corners of a board found in one image."""

    ids: NDArray[np.int64]
    """[N] rows of the board's `points`."""
    pixels: Float64
    """[N, 2] OpenCV convention (centre of the top-left pixel at 0, 0)."""

    def __len__(self) -> int:
        return len(self.ids)

    def chosen(self, rows: Bool) -> Corners:
        """Those under a mask [N]."""
        return Corners(self.ids[rows], self.pixels[rows])


class Board(Protocol):
    """A flat target whose corners a detector finds."""

    @property
    def columns(self) -> int:
        """Along x, in what the kind of board counts."""

    @property
    def rows(self) -> int:
        """Along y."""

    @property
    def points(self) -> Float64:
        """[P, 3] corners in the board's frame, metres, z = 0."""

    @property
    def turns(self) -> int:
        """In how many poses it looks the same: 1 is needed where several cameras look at it."""

    def detect(self, grey: UInt8) -> Corners | None:
        """The corners in an image [H, W]; None where it shows no board."""

    def __str__(self) -> str:
        """Kind and size, for messages and rig files."""


@lru_cache
def lattice(columns: int, rows: int, step: float) -> Float64:
    """Points [rows * columns, 3] of a lattice, row by row; read-only: fits ask for the same again and again."""
    y, x = np.mgrid[:rows, :columns]
    points = np.stack([x.ravel() * step, y.ravel() * step, np.zeros(x.size)], axis=1)
    points.flags.writeable = False
    return points


@dataclass(frozen=True)
class Chessboard:
    """A plain chessboard, counted in inner corners."""

    columns: int
    rows: int
    square: float
    """Edge of a square, m."""

    @property
    def points(self) -> Float64:
        """[P, 3] m."""
        return lattice(self.columns, self.rows, self.square)

    @property
    def turns(self) -> int:
        """A half turn swaps dark and light only where one side has an even and the other an odd number of corners."""
        return 1 if (self.columns + self.rows) % 2 else 2

    def detect(self, grey: UInt8) -> Corners | None:
        """All inner corners, the first beside a dark outer square where the board tells its turn; or None."""
        small = _within(grey, SEARCH_PX)
        if min(small.shape) < SMALLEST_PX:
            return None
        found, corners = cv2.findChessboardCorners(small, (self.columns, self.rows))
        if not found:
            return None
        grid = enlarged(np.asarray(corners, dtype=np.float64), small, grey).reshape(self.rows, self.columns, 2)
        if self.turns == 1 and not _starts_dark(grey, grid):
            grid = grid[::-1, ::-1]
        pixels = refined(grey, grid.reshape(-1, 2), _spacing(grid))
        return Corners(np.arange(len(pixels)), pixels)

    def __str__(self) -> str:
        return f"chessboard {self.columns}x{self.rows}, squares of {self.square:g} m"


@dataclass(frozen=True)
class CircleGrid:
    """A grid of dots, symmetric or (every other row shifted by half a step) asymmetric."""

    columns: int
    rows: int
    spacing: float
    """Between neighbouring centres of a row; of an asymmetric grid: between columns of the unshifted lattice, m."""
    asymmetric: bool = False

    @property
    def points(self) -> Float64:
        """[P, 3] m."""
        points = lattice(self.columns, self.rows, self.spacing).copy()
        if self.asymmetric:
            row = np.repeat(np.arange(self.rows), self.columns)
            points[:, 0] = 2 * points[:, 0] + (row % 2) * self.spacing
        return points

    @property
    def turns(self) -> int:
        """A symmetric grid looks the same after half a turn, as does an asymmetric one of even rows."""
        return 1 if self.asymmetric and self.rows % 2 else 2

    def detect(self, grey: UInt8) -> Corners | None:
        """All centres, or None."""
        kind = cv2.CALIB_CB_ASYMMETRIC_GRID if self.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
        limits = cv2.SimpleBlobDetector.Params()  # its largest blob, 5000 pixels, is a dot 80 pixels wide
        limits.maxArea = max(limits.maxArea, grey.size / (self.columns * self.rows))
        dots, size = cv2.SimpleBlobDetector.create(limits), (self.columns, self.rows)
        found, centres = cv2.findCirclesGrid(grey, size, flags=kind, blobDetector=dots)
        if not found:
            found, centres = cv2.findCirclesGrid(grey, size, flags=kind | cv2.CALIB_CB_CLUSTERING, blobDetector=dots)
        if not found or centres is None:
            return None
        return Corners(np.arange(len(centres)), np.asarray(centres, dtype=np.float64).reshape(-1, 2))

    def __str__(self) -> str:
        kind = "asymmetric circles" if self.asymmetric else "circles"
        return f"{kind} {self.columns}x{self.rows}, spaced by {self.spacing:g} m"


@dataclass(frozen=True)
class CharucoBoard:
    """A chessboard with ArUco markers in its light squares, counted in squares."""

    columns: int
    rows: int
    square: float
    """Edge of a square, m."""
    marker: float
    """Edge of a marker, m."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name."""
    inverted: bool = False
    """Printed light on dark."""
    legacy: bool = False
    """Boards of an even number of rows that were drawn before OpenCV 4.6 start with a marker."""

    @property
    def points(self) -> Float64:
        """[P, 3] inner corners, m."""
        points: Float64 = lattice(self.columns - 1, self.rows - 1, self.square) + np.array(
            [self.square, self.square, 0.0]
        )
        return points

    @property
    def markers(self) -> int:
        """How many it has."""
        return self.columns * self.rows // 2

    @property
    def turns(self) -> int:
        """Markers tell every turn."""
        return 1

    def detect(self, grey: UInt8) -> Corners | None:
        """The inner corners that markers vouch for, or None."""
        image: UInt8 = np.asarray(255 - grey, dtype=np.uint8) if self.inverted else grey
        corners, ids, _, _ = self._detector.detectBoard(image)
        if ids is None or len(ids) == 0:
            return None
        return Corners(np.asarray(ids, np.int64).ravel(), np.asarray(corners, np.float64).reshape(-1, 2))

    @cached_property
    def _detector(self) -> cv2.aruco.CharucoDetector:
        dictionary = marker_dictionary(self.dictionary)
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)
        board.setLegacyPattern(self.legacy)
        return cv2.aruco.CharucoDetector(board)

    def __str__(self) -> str:
        size = f"{self.columns}x{self.rows} ({self.dictionary})"
        return f"charuco {size}, squares of {self.square:g} m, markers of {self.marker:g} m"


def _starts_dark(grey: UInt8, grid: Float64) -> bool:
    """Whether the outer square diagonally before the first corner of `grid` [R, C, 2] is a dark one.

    Judged inside the board, where the picture surely shows it: the squares about the first corner alternate.
    """
    R, C = grid.shape[:2]
    # Centres of all inner squares; those of even (row + column) have the colour of the outer square before the first.
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    values = cv2.remap(grey, centres.astype(np.float32), None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
    row, column = np.mgrid[: R - 1, : C - 1]
    even = (row + column) % 2 == 0
    return bool(values[even].mean() < values[~even].mean())


def _spacing(grid: Float64) -> float:
    """Smallest distance, pixels, between neighbours of a lattice [R, C, 2]."""
    along = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
    return float(min(along))


def refined(grey: UInt8, pixels: Float64, spacing: float) -> Float64:
    """Corners [N, 2] to a fraction of a pixel; `spacing`: smallest distance to the next corner, pixels."""
    half = int(np.clip(REFINE_SHARE * spacing, *REFINE_LIMITS))
    start = np.ascontiguousarray(pixels[:, None], dtype=np.float32)
    found = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), REFINE_STOP)
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def enlarged(pixels: Float64, small: UInt8, grey: UInt8) -> Float64:
    """Pixels [..., 2] of a smaller copy of an image [H, W] as those of the image."""
    whole: Float64 = (pixels + 0.5) * (np.array(grey.shape[::-1]) / small.shape[::-1]) - 0.5
    return whole


def _within(grey: UInt8, longest: int) -> UInt8:
    """An image [H, W], made smaller where one of its sides is longer, pixels."""
    factor = longest / max(grey.shape)
    if factor >= 1:
        return grey
    height, width = (max(round(side * factor), 1) for side in grey.shape)
    return np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
