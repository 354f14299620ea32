"""A grid of AprilTags, and its corners found in an image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.boards import Corners, enlarged, lattice, refined
from twin_node.rig.calibrate.markers import marker_dictionary
from twin_node.scene import Float64, UInt8

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
    def markers(self) -> int:
        """How many it has."""
        return self.columns * self.rows

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
        pixels = refined(images[level], refined(images[level], pixels, 2 * gap), gap)
        if level:
            scale = float((np.array(images[0].shape) / images[level].shape).min())
            whole = enlarged(pixels, images[level], images[0])
            fine = refined(images[0], whole, gap * scale)
            near = np.linalg.norm(fine - whole, axis=1, keepdims=True) < scale  # a blurred corner leads away
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
