"""How what moves has moved in the images of one camera, from set to set: flow, and depth where it is measured."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.kernel_requests import TraceRequest
from twin_node.forecast.kernels import kernels
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float32, Float64, UInt8, View


@dataclass(frozen=True)
class Shifts:
    """Motion in an image since the one before."""

    pixels: Float32
    """[H, W, 2] pixels moved."""
    found: Bool
    """[H, W] what the image before shows where these came from; what has just come into view it does not."""
    receded: Float32 | None
    """[H, W] m by which the depth has grown since; NaN where it was not measured on what moves, None without depth."""
    depth: Float32 | None
    """[H, W] m now."""
    flying: Bool
    """[H, W] what was found as a whole, not by flow: small things that fly far between two images."""
    elapsed_s: float


class ImageMotion:
    """Follows one camera's images of what moves."""

    def __init__(self) -> None:
        self._now: Image | None = None
        self._before: Image | None = None
        # Without refinement: it smears motion over what stands beside, and takes half of the time.
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._flow.setFinestScale(0)

    def see(self, view: View, moving: Bool) -> None:
        """Takes in the next image and where it shows something moving [H, W]."""
        shown = near(moving, 1)
        grey = np.where(shown, cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY), _GREY).astype(np.uint8)
        self._before, self._now = self._now, Image(view.stamp, grey, shown, view.depth)

    @property
    def elapsed_s(self) -> float | None:
        """Time between the last two images, s; None where there are not two that can be compared."""
        now, before = self._now, self._before
        if now is None or before is None or before.stamp >= now.stamp or before.grey.shape != now.grey.shape:
            return None
        return (now.stamp - before.stamp) * 1e-9

    def shifts(self, guess: Float32 | None = None) -> Shifts:
        """Motion from the last image to this one, on what moves alone; asked only where `elapsed_s` is known.

        `guess` [H, W, 2]: shifts that the search for the flow begins with. All that does not move is grey: still ground
        would hold back the flow of thin limbs.
        """
        now, before = self._now, self._before
        assert now is not None and before is not None
        pixels = np.zeros((*now.grey.shape, 2), np.float32)
        window = _window(now.moving | before.moving)
        if window is not None:
            here, there = np.ascontiguousarray(now.grey[window]), np.ascontiguousarray(before.grey[window])
            begin = np.zeros((*here.shape, 2), np.float32) if guess is None else np.ascontiguousarray(-guess[window])
            pixels[window] = -self._flow.calc(here, there, begin)
        trace = traced(now, before, pixels)
        flying = np.zeros(now.grey.shape, np.bool_)
        for flight in _flights(now.blobs, before.blobs):
            flying |= flight.now
            pixels[flight.now] = flight.shift
            if trace.receded is not None:
                trace.receded[flight.now] = _gone_away(now, before, flight)
        return Shifts(pixels, trace.found | flying, trace.receded, now.depth, flying, (now.stamp - before.stamp) * 1e-9)


@dataclass(frozen=True)
class Image:
    """One image."""

    stamp: int
    """ns."""
    grey: UInt8
    """[H, W], `_GREY` where nothing moves."""
    moving: Bool
    """[H, W] what moves, and a pixel about it."""
    depth: Float32 | None
    """[H, W] m, 0 where it is not measured; None without depth."""

    @cached_property
    def blobs(self) -> _Blobs:
        """Of what moves."""
        return _blobs(self.moving)


def traced(now: Image, before: Image, pixels: Float32) -> Traced:
    """Follows what moves back along its way `pixels` [H, W, 2] into the image before.

    Compiled; `traced_plainly` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return traced_plainly(now, before, pixels)
    height, width = now.grey.shape
    found = Traced(np.empty((height, width), np.bool_), None)
    depths: tuple[Float32, ...] = ()
    if now.depth is not None and before.depth is not None and before.depth.shape == now.depth.shape:
        found = Traced(found.found, np.empty((height, width), np.float32))
        depths = tuple(np.ascontiguousarray(depth, np.float32) for depth in (now.depth, before.depth))
    masks = tuple(np.ascontiguousarray(mask, np.bool_) for mask in (now.moving, before.moving))
    given = (now.grey, before.grey, *masks, np.ascontiguousarray(pixels, np.float32), *(depths or (None, None)))
    compiled.trace(TraceRequest(width, height, _ALIKE_GREY, *addresses_of(*given, found.found, found.receded)))
    return found


def traced_plainly(now: Image, before: Image, pixels: Float32) -> Traced:
    """What `traced` does."""
    height, width = now.grey.shape
    rows, columns = np.nonzero(now.moving)
    source = np.round(np.stack([columns, rows], axis=1) - pixels[rows, columns]).astype(np.int64)
    inside = ((source >= 0) & (source < (width, height))).all(axis=1)
    rows, columns, source = rows[inside], columns[inside], source[inside]
    change = now.grey[rows, columns].astype(np.int16) - before.grey[source[:, 1], source[:, 0]]
    alike = before.moving[source[:, 1], source[:, 0]] & (np.abs(change) < _ALIKE_GREY)
    found = np.zeros((height, width), np.bool_)
    found[rows, columns] = alike
    if now.depth is None or before.depth is None or before.depth.shape != now.depth.shape:
        return Traced(found, None)
    here, there = now.depth[rows, columns], before.depth[source[:, 1], source[:, 0]]
    receded = np.full((height, width), np.nan, np.float32)
    receded[rows, columns] = np.where(alike & (here > 0) & (there > 0), here - there, np.nan)
    return Traced(found, receded)


@dataclass(frozen=True)
class Traced:
    """What an image shows to move, in the image before."""

    found: Bool
    """[H, W] True where that showed something moving that looks the same."""
    receded: Float32 | None
    """[H, W] m by which its depth has grown, NaN where it is not known; None without depth."""


def _gone_away(now: Image, before: Image, flight: _Flight) -> float:
    """By how much the depth of a blob has grown, m; NaN where it was not measured both times."""
    assert now.depth is not None and before.depth is not None
    here, there = now.depth[flight.now], before.depth[flight.before]
    here, there = here[here > 0], there[there > 0]
    return float(np.median(here) - np.median(there)) if len(here) and len(there) else np.nan


@dataclass(frozen=True)
class _Flight:
    """A blob that has flown."""

    now: Bool
    """[H, W] its pixels."""
    before: Bool
    """[H, W] those that it had in the image before."""
    shift: Float64
    """[2] pixels, of its middle: what it shows may turn."""


def _flights(mine: _Blobs, others: _Blobs) -> list[_Flight]:
    """Small things that went further between two images than flow looks, by the blobs of now and of before."""
    if len(mine.areas) == 0 or len(others.areas) == 0:
        return []
    ways = mine.middles[:, None] - others.middles[None]
    widths = np.sqrt(mine.areas)[:, None]
    alike = np.maximum(mine.areas[:, None], others.areas) < _ALIKE * np.minimum(mine.areas[:, None], others.areas)
    shares = np.where(alike, np.linalg.norm(ways, axis=2) / widths, np.inf)
    return [
        _Flight(mine.labels == mine.numbers[blob], others.labels == others.numbers[other], ways[blob, other])
        for blob, other in enumerate(shares.argmin(axis=1).tolist())
        if _FOUND < shares[blob, other] < _FLIGHT and shares[:, other].argmin() == blob
    ]


@dataclass(frozen=True)
class _Blobs:
    """Compact blobs of what moves in one image."""

    labels: NDArray[np.int32]
    """[H, W] of all blobs, compact or not."""
    numbers: NDArray[np.int64]
    """[b] their labels."""
    areas: Float64
    """[b] pixels."""
    middles: Float64
    """[b, 2] pixels."""


def _blobs(mask: Bool) -> _Blobs:
    """The blobs of a mask [H, W] that fill most of a box about them: bodies and their rims are none."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    within = slice(top, top + height), slice(left, left + width)
    labels = np.zeros(mask.shape, np.int32)
    if width == 0:
        return _Blobs(labels, np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 2)))
    _, labels[within], stats, middles = cv2.connectedComponentsWithStats(mask[within].astype(np.uint8))
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.float64)
    sides = np.maximum(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    compact = (areas >= _SMALLEST_BLOB) & (areas > _COMPACT * sides**2)
    numbers = np.flatnonzero(compact[1:]) + 1
    inside = middles[numbers].astype(np.float64)
    return _Blobs(labels, numbers, areas[numbers], inside + np.array([left, top]))


_GREY = np.uint8(128)
"""Brightness that all that does not move is painted with."""
_ALIKE_GREY = 30
"""Difference in brightness up to which two pixels may show the same, of 255: four sigmas of noise in poor light."""
_SMALLEST_WINDOW = 32
"""Side in pixels of the smallest image that optical flow is computed on: two coarse patches."""
_SMALLEST_BLOB = 12
"""Pixels; smaller blobs come and go."""
_COMPACT = 0.5
"""Share of the square about it that a blob fills at least; a disk fills 0.79."""
_ALIKE = 1.6
"""A blob is taken for another of at most so many times its area."""
_FOUND, _FLIGHT = 0.3, 3.0
"""Blobs that came by more than the first and less than the second of these times their width since the last image
are found as a whole: flow finds nearer ones, and limbs of a body better. 3: a ball of 0.1 m at 9 m/s and 30 Hz."""


def _window(mask: Bool) -> tuple[slice, slice] | None:
    """Rows and columns about the pixels of a mask, some more on each side; None for an empty mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    slices = []
    for used, size in ((rows, mask.shape[0]), (columns, mask.shape[1])):
        margin = max(8, (_SMALLEST_WINDOW - int(used[-1] - used[0])) // 2 + 1)
        slices.append(slice(max(0, int(used[0]) - margin), min(size, int(used[-1]) + margin + 1)))
    return slices[0], slices[1]


def near(mask: Bool, pixels: int) -> Bool:
    """The pixels of a mask and so many about them."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * pixels + 1,) * 2, np.uint8)) > 0
