"""How what moves has moved in the images of one camera, from set to set: flow, and depth where it is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from twin_node.forecast.blobs import COMPACT, SMALLEST_BLOB, Blobs, blobs_reference, flights_reference
from twin_node.forecast.kernels import kernels
from twin_node.forecast.pace import LONGEST_GAP_S
from twin_node.forecast.part_requests import SeeRequest, SeeRequests
from twin_node.native_library import addresses_of, array_of, thread_count
from twin_node.scene import Bool, Float32, UInt8, View


class Window(NamedTuple):
    """A part of an image: columns and rows from the first to one before the last; all 0 for none."""

    left: int
    right: int
    top: int
    bottom: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def slices_of(self, other: Window) -> tuple[slice, slice]:
        """The same in a window that holds this one."""
        rows, columns = (
            (self.top - other.top, self.bottom - other.top),
            (self.left - other.left, self.right - other.left),
        )
        return slice(*rows), slice(*columns)

    def wider(self, pixels: int, width: int, height: int) -> Window:
        """With so many more on each side, in an image of so many pixels."""
        left, right = max(0, self.left - pixels), min(width, self.right + pixels)
        return Window(left, right, max(0, self.top - pixels), min(height, self.bottom + pixels))

    def joined(self, other: Window) -> Window:
        """The least that holds both."""
        if self.right == 0 or other.right == 0:
            return self if other.right == 0 else other
        left, right = min(self.left, other.left), max(self.right, other.right)
        return Window(left, right, min(self.top, other.top), max(self.bottom, other.bottom))

    def within(self, width: int, height: int) -> Window:
        """With some more on each side, in an image of so many pixels."""
        if self.right == 0:
            return self
        across, down = (_margin(end - begin) for begin, end in (self[:2], self[2:]))
        left, right = max(0, self.left - across), min(width, self.right + across)
        return Window(left, right, max(0, self.top - down), min(height, self.bottom + down))


def _margin(size: int) -> int:
    return max(8, (_SMALLEST_WINDOW - size + 1) // 2 + 1)


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
    blobs: Blobs
    """Of what moves."""
    window: Window
    """About what moves."""


def seen(views: Sequence[View], moving: Sequence[Bool]) -> list[Image]:
    """The images of views that show something moving [H, W] each. Compiled; `seen_reference` where that cannot be."""
    compiled = kernels()
    if compiled is None:
        return [seen_reference(*one) for one in zip(views, moving, strict=True)]
    rows = [_SeenRow(view, mask) for view, mask in zip(views, moving, strict=True)]
    requests = array_of(SeeRequest, [row.request() for row in rows])
    compiled.run(SeeRequests(len(rows), thread_count(), requests))
    return [row.image() for row in rows]


class _SeenRow:
    """What the kernel is given of one view, and room for what it says."""

    def __init__(self, view: View, moving: Bool) -> None:
        self._view = view
        self._given = np.ascontiguousarray(view.rgb, np.uint8), np.ascontiguousarray(moving, np.bool_)
        self._grey, self._shown = np.empty(moving.shape, np.uint8), np.empty(moving.shape, np.bool_)
        self._labels = np.empty(moving.shape, np.int32)
        self._compact, self._found = np.empty((moving.size // SMALLEST_BLOB + 1, 4)), np.empty(5, np.int64)

    def request(self) -> SeeRequest:
        height, width = self._view.rgb.shape[:2]
        arrays = (*self._given, self._grey, self._shown, self._labels, self._compact, self._found)
        return SeeRequest(width, height, _GREY, SMALLEST_BLOB, COMPACT, *addresses_of(*arrays))

    def image(self) -> Image:
        count, *window = self._found.tolist()
        blobs = Blobs(self._labels, self._compact[:count].copy())
        return Image(self._view.stamp, self._grey, self._shown, _measured(self._view), blobs, Window(*window))


def seen_reference(view: View, moving: Bool) -> Image:
    """What `seen` does."""
    shown = near(moving, 1)
    grey = np.where(shown, cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY), _GREY).astype(np.uint8)
    left, top, width, height = cv2.boundingRect(shown.astype(np.uint8))
    window = Window(left, left + width, top, top + height) if width else Window(0, 0, 0, 0)
    return Image(view.stamp, grey, shown, _measured(view), blobs_reference(shown), window)


def _measured(view: View) -> Float32 | None:
    return None if view.depth is None else np.ascontiguousarray(view.depth, np.float32)


@dataclass(frozen=True)
class Pair:
    """Two images of a view, one after the other, and the flow between them."""

    now: Image
    before: Image
    window: Window
    """About what moves in either."""
    flow: Float32
    """[h, w, 2] pixels from where something is now to where it was before, in the window."""

    @property
    def elapsed_s(self) -> float:
        """Between them."""
        return (self.now.stamp - self.before.stamp) * 1e-9

    @property
    def has_depth(self) -> bool:
        """Whether both have depth, and as many pixels of it."""
        now, before = self.now.depth, self.before.depth
        return now is not None and before is not None and before.shape == now.shape


class ImageMotion:
    """Follows one camera's images of what moves."""

    def __init__(self) -> None:
        self._now: Image | None = None
        self._before: Image | None = None
        # Without refinement: it smears motion over what stands beside, and takes half of the time.
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._flow.setFinestScale(0)

    def see(self, image: Image) -> None:
        """Takes in the next image."""
        self._before, self._now = self._now, image

    @property
    def elapsed_s(self) -> float | None:
        """Time between the last two images, s; None where there are not two that can be compared.

        Those of before and after a long gap cannot: what has gone to and fro meanwhile would be told to stand. Nor can
        those that are too small for optical flow.
        """
        now, before = self._now, self._before
        if now is None or before is None or before.grey.shape != now.grey.shape:
            return None
        if min(now.grey.shape) < _LEAST_SIDE or max(now.grey.shape) < _LEAST_LENGTH:
            return None
        elapsed_s = (now.stamp - before.stamp) * 1e-9
        return elapsed_s if 0 < elapsed_s <= LONGEST_GAP_S else None

    @property
    def window(self) -> Window:
        """About what moves in either of the last two images; asked only where `elapsed_s` is known."""
        now, before = self._now, self._before
        assert now is not None and before is not None
        height, width = now.grey.shape
        return now.window.joined(before.window).within(width, height)

    def pair(self, window: Window, guess: Float32 | None = None) -> Pair:
        """The last two images, and the flow on what moves alone; asked only where `elapsed_s` is known.

        `window`: of them. `guess` [h, w, 2]: pixels moved in it that the search for the flow begins with. All that does
        not move is grey: still ground would hold back the flow of thin limbs.
        """
        now, before = self._now, self._before
        assert now is not None and before is not None
        here, there = (np.ascontiguousarray(image.grey[window.slices]) for image in (now, before))
        flow = np.zeros((*here.shape, 2), np.float32) if guess is None else -guess
        if flow.size:
            flow = np.ascontiguousarray(self._flow.calc(here, there, flow), np.float32)
        return Pair(now, before, window, flow)


@dataclass(frozen=True)
class Shifts:
    """Motion in an image since the one before."""

    pixels: Float32
    """[H, W, 2] pixels moved."""
    found: Bool
    """[H, W] what the image before shows where these came from; what has just come into view it does not."""
    receded: Float32 | None
    """[H, W] m by which the depth has grown since; NaN where it was not measured on what moves, None without depth."""
    flying: Bool
    """[H, W] what was found as a whole, not by flow: small things that fly far between two images."""


def shifts_reference(pair: Pair) -> Shifts:
    """What all pixels of what moves show; the compiled code looks up those that are asked for."""
    now, before = pair.now, pair.before
    pixels = np.zeros((*now.grey.shape, 2), np.float32)
    pixels[pair.window.slices] = -pair.flow
    found, receded = _traced(pair, pixels)
    flying = np.zeros(now.grey.shape, np.bool_)
    for flight in flights_reference(now.blobs, before.blobs):
        flying |= flight.now
        pixels[flight.now] = flight.shift
        if receded is not None and now.depth is not None and before.depth is not None:
            receded[flight.now] = flight.gone_away(now.depth, before.depth)
    return Shifts(pixels, found | flying, receded, flying)


def _traced(pair: Pair, pixels: Float32) -> tuple[Bool, Float32 | None]:
    """What moves, followed back along its way `pixels` [H, W, 2] into the image before.

    [H, W] where that showed something moving that looks the same, and by how much its depth has grown, m; NaN where
    that is not known.
    """
    now, before = pair.now, pair.before
    height, width = now.grey.shape
    rows, columns = np.nonzero(now.moving)
    source = np.round(np.stack([columns, rows], axis=1) - pixels[rows, columns]).astype(np.int64)
    inside = ((source >= 0) & (source < (width, height))).all(axis=1)
    rows, columns, source = rows[inside], columns[inside], source[inside]
    change = now.grey[rows, columns].astype(np.int16) - before.grey[source[:, 1], source[:, 0]]
    alike = before.moving[source[:, 1], source[:, 0]] & (np.abs(change) < ALIKE_GREY)
    found = np.zeros((height, width), np.bool_)
    found[rows, columns] = alike
    if not pair.has_depth or now.depth is None or before.depth is None:
        return found, None
    here, there = now.depth[rows, columns], before.depth[source[:, 1], source[:, 0]]
    receded = np.full((height, width), np.nan, np.float32)
    receded[rows, columns] = np.where(alike & (here > 0) & (there > 0), here - there, np.nan)
    return found, receded


_GREY = 128
"""Brightness that all that does not move is painted with."""
ALIKE_GREY = 30
"""Difference in brightness up to which two pixels may show the same, of 255: four sigmas of noise in poor light."""
_SMALLEST_WINDOW = 32
"""Side in pixels of the smallest image that optical flow is computed on: two coarse patches."""
_LEAST_SIDE, _LEAST_LENGTH = 8, 12
"""Pixels of the shorter and the longer side of the smallest images that OpenCV computes it on at all."""


def near(mask: Bool, pixels: int) -> Bool:
    """The pixels of a mask and so many about them."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * pixels + 1,) * 2, np.uint8)) > 0
