"""Calibration targets: where their corners are, and the corners found in an image (OpenCV's detectors)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.rig.errors import RigError
from twin_node.scene import Bool, Float64, UInt8

REFINE_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
"""Sub-pixel refinement ends after 60 rounds or below 1e-4 pixels: far under the 0.05 that corners are good for."""

REFINE_SHARE = 0.35
"""Half of the refinement window as a share of the distance to the next corner: a window that reaches the neighbours'
edges is biased (on 640x480 pictures of a chessboard 11 pixels gave twice the residual of 5)."""

REFINE_LIMITS = (2, 11)
"""Smallest and largest half window, pixels: below it noise rules, above it the window adds blur, not evidence."""

BORDERS = (1, 2)
"""Widths, in cells, of the black frame of AprilTags: 1 as most tools print them, 2 as Kalibr does."""

MAX_TAG_ERROR = 0.2
"""Largest distance of a tag's corner from where the other tags want it, in tag widths; beyond it the tag is misread."""


LEGIBLE_PX = 60.0
"""Longest edge of a tag whose frame, a fifth of it, is narrower than a detector's window: within a wider frame nothing
is darker than what is about it, and an edge may be found there, a module off."""

SMALLEST_PX = 240
"""Images are not halved to smaller ones than this."""


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
        found, corners = cv2.findChessboardCorners(grey, (self.columns, self.rows))
        if not found:
            return None
        grid = np.asarray(corners, dtype=np.float64).reshape(self.rows, self.columns, 2)
        if self.turns == 1 and not _starts_dark(grey, grid):
            grid = grid[::-1, ::-1]
        pixels = _refined(grey, grid.reshape(-1, 2), _spacing(grid))
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


@dataclass(frozen=True)
class _Tags:
    """Tags read in one image."""

    ids: NDArray[np.int64]
    """[T] their numbers."""
    quads: Float64
    """[T, 4, 2] their corners, pixels, in the order of the board's `points`."""
    off: float
    """Median distance of a tag's corner from where the other tags want it, in tag widths; infinite of too few."""


@dataclass(frozen=True)
class AprilGrid:
    """A grid of AprilTags as Kalibr prints it: numbered from the bottom left, row by row."""

    columns: int
    rows: int
    tag: float
    """Edge of a tag's black frame, m."""
    spacing: float
    """Gap between tags as a share of `tag`."""
    dictionary: str = "DICT_APRILTAG_36h11"
    """OpenCV's name."""

    @property
    def points(self) -> Float64:
        """[P, 3] m: four corners per tag, counterclockwise from the bottom left (y up), tag by tag."""
        corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * self.tag
        step = self.tag * (1 + self.spacing)
        return (lattice(self.columns, self.rows, step)[:, None] + corners).reshape(-1, 3)

    @property
    def turns(self) -> int:
        """Tags tell every turn."""
        return 1

    def detect(self, grey: UInt8) -> Corners | None:
        """The corners of all tags that agree on where the board is (four at least), or None."""
        images = _halved(grey)
        by_border = [[self._in_order(self._tags(image, border)) for image in images] for border in BORDERS]
        read = min(by_border, key=lambda tags: min(own.off for own in tags))
        levels = _legible(read)
        if len(levels) < 4:
            return None
        corners: dict[int, Float64] = {}
        for level, tags in enumerate(read):
            own = [i for i, number in enumerate(tags.ids.tolist()) if levels[number] == level]
            if own:
                corners.update(zip(tags.ids[own].tolist(), self._refined(images, level, tags.quads[own]), strict=True))
        ids = np.array(sorted(corners))
        return Corners((4 * ids[:, None] + np.arange(4)).ravel(), np.concatenate([corners[i] for i in ids.tolist()]))

    def _refined(self, images: Sequence[UInt8], level: int, quads: Float64) -> Float64:
        """[T, 4, 2] corners in the first image of tags that were read in the one of `level`."""
        pixels, sides = quads.reshape(-1, 2), np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2)
        gap = float(sides.min()) * self.spacing
        # Kalibr's black squares at the corners push the outline off by a few pixels: first a wide window, then a small.
        pixels = _refined(images[level], _refined(images[level], pixels, 2 * gap), gap)
        if level:
            scale = np.array(images[0].shape[::-1]) / images[level].shape[::-1]
            whole = (pixels + 0.5) * scale - 0.5
            fine = _refined(images[0], whole, gap * float(scale.min()))
            near = np.linalg.norm(fine - whole, axis=1, keepdims=True) < scale.min()  # a blurred corner leads away
            pixels = np.where(near, fine, whole)
        return pixels.reshape(-1, 4, 2)

    def _tags(self, grey: UInt8, border: int) -> dict[int, Float64]:
        """Corners [4, 2] of the tags of the board, by number."""
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = border
        detector = cv2.aruco.ArucoDetector(marker_dictionary(self.dictionary), parameters)
        quads, ids, _ = detector.detectMarkers(grey)
        numbers: list[int] = [] if ids is None else np.asarray(ids, np.int64).ravel().tolist()
        return {
            number: np.asarray(quad, np.float64).reshape(4, 2)
            for number, quad in zip(numbers, quads, strict=True)
            if 0 <= number < self.columns * self.rows
        }

    def _in_order(self, tags: Mapping[int, Float64]) -> _Tags:
        """Tags [4, 2] by number, from the corners that `points` begin with, without those that others say are misread.

        Tools disagree on which corner of a tag comes first, and in which sense: the tags' places on the board decide.
        """
        none = _Tags(np.zeros(0, np.int64), np.zeros((0, 4, 2)), np.inf)
        if len(tags) < 4:
            return none
        ids = np.array(sorted(tags))
        quads = np.stack([tags[i] for i in ids])
        model, edge = self.points.reshape(-1, 4, 3)[ids, :, :2], self._edge(quads)
        H, _ = cv2.findHomography(model.mean(axis=1), quads.mean(axis=1), cv2.RANSAC, 0.5 * edge)
        if H is None:
            return none
        expected = cv2.perspectiveTransform(model.reshape(1, -1, 2), H).reshape(quads.shape)
        orders = [np.roll(quads[:, ::sense], turn, axis=1) for sense in (1, -1) for turn in range(4)]
        errors = [np.linalg.norm(order - expected, axis=2).max(axis=1) / edge for order in orders]
        best = int(np.argmin([np.median(error) for error in errors]))
        agree = errors[best] < MAX_TAG_ERROR
        off = float(np.median(errors[best])) if agree.sum() >= 4 else np.inf
        return _Tags(ids[agree], orders[best][agree], off)

    @staticmethod
    def _edge(quads: Float64) -> float:
        return float(np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2).mean())

    def __str__(self) -> str:
        size = f"{self.columns}x{self.rows} ({self.dictionary})"
        return f"aprilgrid {size}, tags of {self.tag:g} m, gaps of {self.spacing:g}"


def marker_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's predefined dictionary of that name. Raises `RigError` for an unknown one."""
    number = getattr(cv2.aruco, name, None)
    if not name.startswith("DICT_") or not isinstance(number, int):
        raise RigError(f"marker dictionary: expected one of OpenCV's names (DICT_4X4_50, ...), found {name!r}")
    return cv2.aruco.getPredefinedDictionary(number)


def dictionary_of(board: CharucoBoard | AprilGrid) -> cv2.aruco.Dictionary:
    """The dictionary of a board's markers. Raises `RigError` for an unknown one, and for one that has too few."""
    dictionary, cells = marker_dictionary(board.dictionary), board.columns * board.rows
    most, markers = len(dictionary.bytesList), cells // 2 if isinstance(board, CharucoBoard) else cells
    if markers > most:
        raise RigError(
            f"board: expected at most {most} markers, as many as {board.dictionary} has, found {markers}; use a larger "
            "dictionary, for example DICT_4X4_250"
        )
    return dictionary


def _halved(grey: UInt8) -> list[UInt8]:
    """An image [H, W], and it halved again and again."""
    images = [grey]
    while min(images[-1].shape) >= 2 * SMALLEST_PX:
        height, width = images[-1].shape
        small = cv2.resize(images[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        images.append(np.asarray(small, np.uint8))
    return images


def _legible(read: Sequence[_Tags]) -> dict[int, int]:
    """The level that each tag is taken from, of those read in an image halved again and again: the finest legible."""
    levels: dict[int, int] = {}
    for level in reversed(range(len(read))):
        longest = np.linalg.norm(read[level].quads - np.roll(read[level].quads, 1, axis=1), axis=2).max(axis=1)
        for number, edge in zip(read[level].ids.tolist(), longest.tolist(), strict=True):
            if edge <= LEGIBLE_PX or number not in levels:
                levels[number] = level
    return levels


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


def _refined(grey: UInt8, pixels: Float64, spacing: float) -> Float64:
    """Corners [N, 2] to a fraction of a pixel; `spacing`: smallest distance to the next corner, pixels."""
    half = int(np.clip(REFINE_SHARE * spacing, *REFINE_LIMITS))
    start = np.ascontiguousarray(pixels[:, None], dtype=np.float32)
    refined = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), REFINE_STOP)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)
