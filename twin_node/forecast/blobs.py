"""Compact blobs of what moves in images, and how they fly from image to image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Bool, Float32, Float64

SMALLEST_BLOB = 12
"""Pixels; smaller blobs come and go."""
COMPACT = 0.5
"""Share of the square about it that a blob fills at least; a disk fills 0.79."""
SAME_AREA = 1.6
"""A blob is taken for another of at most so many times its area."""
FOUND, FLIGHT = 0.3, 3.0
"""Blobs that came by more than the first and less than the second of these times their width since the last image
are found as a whole: flow finds nearer ones, and limbs of a body better. 3: a ball of 0.1 m at 9 m/s and 30 Hz."""


@dataclass(frozen=True)
class Blobs:
    """Blobs of what moves in one image: pixels that touch at sides or corners."""

    labels: NDArray[np.int32]
    """[H, W] of all blobs, compact or not, from 1 on; 0 where nothing moves."""
    compact: Float64
    """[b, 4] label, pixels, and column and row of the middle of those that fill most of a box about them: bodies and
    their rims are none."""

    @property
    def areas(self) -> Float64:
        """[b] pixels of the compact ones."""
        return self.compact[:, 1]

    @property
    def middles(self) -> Float64:
        """[b, 2] pixels, of the compact ones."""
        return self.compact[:, 2:]

    def pixels_of(self, row: int) -> Bool:
        """[H, W] of the compact blob in a row."""
        mine: Bool = self.labels == self.compact[row, 0]
        return mine


def blobs_reference(mask: Bool) -> Blobs:
    """The blobs of a mask [H, W]."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    within = slice(top, top + height), slice(left, left + width)
    labels = np.zeros(mask.shape, np.int32)
    if width == 0:
        return Blobs(labels, np.zeros((0, 4)))
    _, labels[within], stats, middles = cv2.connectedComponentsWithStats(mask[within].astype(np.uint8))
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.float64)
    sides = np.maximum(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    compact = (areas >= SMALLEST_BLOB) & (areas > COMPACT * sides**2)
    numbers = np.flatnonzero(compact[1:]) + 1
    inside = middles[numbers].astype(np.float64) + np.array([left, top])
    return Blobs(labels, np.column_stack([numbers, areas[numbers], inside]))


@dataclass(frozen=True)
class Flight:
    """A blob that has flown."""

    now: Bool
    """[H, W] its pixels."""
    before: Bool
    """[H, W] those that it had in the image before."""
    shift: Float64
    """[2] pixels, of its middle: what it shows may turn."""

    def gone_away(self, depth: Float32, depth_before: Float32) -> float:
        """By how much its depth [H, W] (m, 0 where not measured) has grown, m; NaN where it is not known both times."""
        here, there = depth[self.now], depth_before[self.before]
        here, there = here[here > 0], there[there > 0]
        return float(np.median(here) - np.median(there)) if len(here) and len(there) else np.nan


def flights_reference(mine: Blobs, others: Blobs) -> list[Flight]:
    """Small things that went further between two images than flow looks, by the blobs of now and of before."""
    if len(mine.compact) == 0 or len(others.compact) == 0:
        return []
    ways = mine.middles[:, None] - others.middles[None]
    widths = np.sqrt(mine.areas)[:, None]
    alike = np.maximum(mine.areas[:, None], others.areas) < SAME_AREA * np.minimum(mine.areas[:, None], others.areas)
    shares = np.where(alike, np.linalg.norm(ways, axis=2) / widths, np.inf)
    return [
        Flight(mine.pixels_of(blob), others.pixels_of(other), ways[blob, other])
        for blob, other in enumerate(shares.argmin(axis=1).tolist())
        if FOUND < shares[blob, other] < FLIGHT and shares[:, other].argmin() == blob
    ]
