"""What one view says along the ray of every pixel: how far it is free, and where something moves."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast import kernel_requests, kernels
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.tables import CameraTable
from twin_node.forecast.verdicts import BESIDE, MOVING, ROBOT, SEEN, Sight, Surface
from twin_node.native_library import address_of, addresses_of, thread_count
from twin_node.ranges import POSITIVE, SHARE, Range, check_ranges
from twin_node.scene import Bool, Float32, UInt8, View

_NEVER = np.float32(0)
_ALWAYS = np.float32(1e6)
_SLANT_M = 0.05
"""By how much a surface's depth may differ within the error of calibration, m."""
_SPECK = 4
"""Pixels; what so few show to stand out is noise of their depth, and would be grown as a thing."""
_MEASURED_WITHIN = 2
"""Pixels; an unmeasured one that moves is a hole in what is measured so near, else of a thing that is not measured."""
LEAST_BLANK = 12
"""Pixels of the smallest such thing. Fewer, or what is nowhere two pixels wide, are ground that is bare again and that
an image happens not to measure: edges of what stands lack depth here and there."""
_RADII = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 48.0)
"""Radii in pixels that widths in the image are told apart by."""


@dataclass(frozen=True)
class CarvingParameters:
    """How far a camera is trusted to free space."""

    sigmas: float = 2.0
    """Calibration error that the moving mask is widened by, in sigmas of `Camera.sigma_m`."""
    assumed_sigma_m: float = 0.003
    """Calibration error ascribed to cameras whose own is unknown, m: what the real rigs of `calibration/` have."""
    depth_margin: float = 0.015
    """Space is freed up to this far in front of a measured surface, m, plus `depth_share` of its depth."""
    depth_share: float = 0.01
    """Depth error as a share of depth."""
    thickness: float = 0.3
    """Most depth behind a measured moving surface that may belong to the thing, m; a torso from front to back."""
    thickness_share: float = 1.25
    """A thing is at most this many times as thick as it is wide in the image, plus `depth_margin`."""

    def __post_init__(self) -> None:
        """Raises `ForecastError` for a number that is none of its kind."""
        check_ranges(
            self,
            ForecastError,
            "forecast: carving.",
            sigmas=Range(0, 100),
            assumed_sigma_m=Range(0, 0.5),
            depth_margin=Range(0, 1),
            depth_share=SHARE,
            thickness=Range(0, 10, above=True),
            thickness_share=POSITIVE,
        )


@dataclass(frozen=True)
class Look:
    """One view, and what is known of what it shows."""

    table: CameraTable
    view: View
    moving: Bool
    """[H, W] what moves."""
    robot: Bool | None
    """[H, W] the arm."""
    backdrop: Float32 | None
    """[H, W] depth of what stands behind each pixel, m; None without depth."""
    error_pixels: float
    """By which masks and surfaces may be off."""

    @property
    def hidden(self) -> Bool | None:
        """[H, W] the arm, and pixels that show nothing of use; None where there are neither."""
        if self.view.valid is None:
            return self.robot
        return ~self.view.valid if self.robot is None else ~self.view.valid | self.robot


def sights_of(looks: Sequence[Look], parameters: CarvingParameters) -> list[Sight]:
    """What each look says. Compiled; `sight_reference` where that cannot be."""
    compiled = kernels.kernels()
    if compiled is None:
        return [sight_reference(look, parameters) for look in looks]
    given = (kernel_requests.LookView * len(looks))()
    sights = [_room(look) for look in looks]
    held = [_arrays(look, sight) for look, sight in zip(looks, sights, strict=True)]  # alive until the call is over
    for row, (look, arrays) in enumerate(zip(looks, held, strict=True)):
        camera = look.view.camera
        given[row] = kernel_requests.LookView(
            camera.width, camera.height, camera.K[0, 0], look.error_pixels, *addresses_of(*arrays)
        )
    p, radii = parameters, np.array(_RADII)
    counts = (len(looks), thread_count(), len(radii), _SPECK, _MEASURED_WITHIN, LEAST_BLANK)
    lengths = (p.depth_margin, p.depth_share, p.thickness, p.thickness_share, _SLANT_M)
    compiled.run(kernel_requests.LookRequest(*counts, address_of(radii), *lengths, ctypes.addressof(given)))
    return sights


def _room(look: Look) -> Sight:
    """Arrays for what a look says."""
    size = look.table.outside + 1
    depths = np.empty((3, size), np.float32)
    surface = None if look.view.depth is None else Surface(depths[1], depths[2])
    return Sight(look.table, depths[0], np.empty(size, np.uint8), surface)


def _arrays(look: Look, sight: Sight) -> tuple[NDArray[np.generic] | None, ...]:
    """In the order of `kernel_requests.LookView`."""
    depths, masks = (look.view.depth, look.backdrop), (look.moving, look.robot, look.view.valid)
    surface = (None, None) if sight.surface is None else (sight.surface.begin, sight.surface.end)
    return (
        *(None if one is None else np.ascontiguousarray(one, np.float32) for one in depths),
        *(None if one is None else np.ascontiguousarray(one, np.bool_) for one in masks),
        *(sight.free_until, *surface, sight.flags),
    )


def sight_reference(look: Look, parameters: CarvingParameters) -> Sight:
    """What `sights_of` does with one look."""
    view, moving, robot, error_pixels = look.view, look.moving, look.robot, look.error_pixels
    seen = np.ones(moving.shape, np.bool_) if view.valid is None else view.valid
    blind = ~seen if robot is None else ~seen | robot
    widened = dilated(moving, error_pixels)
    found = None if look.backdrop is None else _found(view, moving, blind, look.backdrop, parameters)
    blank = np.zeros_like(moving) if found is None else _blank(view, moving, blind, found)
    free_image = _free_until(view, widened | blind, ~seen | blank, error_pixels, parameters)
    blunt = widened & ~blind
    if view.depth is not None:
        blunt &= (view.depth == 0) | dilated(blank, error_pixels)
    flags = blunt * MOVING + seen * SEEN + (seen & ~moving & ~blind) * BESIDE
    if robot is not None:
        flags += (robot & seen) * ROBOT
    surface = None
    if look.backdrop is not None and found is not None:
        surface = _surface(view, moving, blind, found, look.backdrop, parameters, error_pixels)
    return Sight(
        look.table,
        free_until=np.append(free_image, _NEVER),
        flags=np.append(flags, np.uint8(0)),
        surface=surface,
    )


def _free_until(view: View, hidden: Bool, unseen: Bool, error_pixels: float, parameters: CarvingParameters) -> Float32:
    """[H, W] depth up to which each pixel frees its ray, m: to what was measured, be it the arm, or all of it.

    Without depth `hidden` pixels free nothing; with it those that show nothing at all.
    """
    if view.depth is None:
        return np.where(hidden, _NEVER, _ALWAYS).astype(np.float32)
    surface = np.where(view.depth > 0, view.depth * (1 - parameters.depth_share) - parameters.depth_margin, _ALWAYS)
    nearest = cv2.erode(surface.astype(np.float32), np.ones((3, 3), np.uint8))  # single pixels lack depth everywhere
    surface = np.where(view.depth > 0, surface, np.where(nearest < _ALWAYS, nearest, _NEVER))
    free = np.where(unseen, _NEVER, surface).astype(np.float32)
    return cv2.erode(free, _disk(error_pixels)).astype(np.float32) if error_pixels >= 1 else free


def _found(view: View, moving: Bool, blind: Bool, backdrop: Float32, parameters: CarvingParameters) -> Bool:
    """[H, W] where a view with depth measures something that moves, in front of what stands."""
    assert view.depth is not None
    stands_out = view.depth < backdrop * (1 - parameters.depth_share) - parameters.depth_margin
    return _without_specks(moving & ~blind & (view.depth > 0) & stands_out)


def _blank(view: View, moving: Bool, blind: Bool, found: Bool) -> Bool:
    """[H, W] where something moves that is not measured there nor around: dark, or too thin.

    What is measured beside it is what stands behind: it must free nothing there.
    """
    assert view.depth is not None
    near = cv2.dilate(found.astype(np.uint8), np.ones((2 * _MEASURED_WITHIN + 1,) * 2, np.uint8)) > 0
    return _without_specks(_in_squares(moving & ~blind & (view.depth == 0) & ~near), LEAST_BLANK)


def _in_squares(mask: Bool) -> Bool:
    """What of a mask [H, W] lies in squares of two by two of its pixels."""
    squares = mask[:-1, :-1] & mask[1:, :-1] & mask[:-1, 1:] & mask[1:, 1:]
    kept = np.zeros_like(mask)
    for rows, columns in itertools.product((slice(None, -1), slice(1, None)), repeat=2):
        kept[rows, columns] |= squares
    return kept


def _surface(
    view: View,
    moving: Bool,
    blind: Bool,
    found: Bool,
    backdrop: Float32,
    parameters: CarvingParameters,
    error_pixels: float,
) -> Surface:
    """The moving surface of a view with depth, widened by the calibration's error.

    A thing begins where it is measured: in front of it is space that is free, or that nobody sees. It is not much
    thicker than it is wide, and ends where something that stands was seen behind it.
    """
    assert view.depth is not None
    width = 2 * _local_radius(moving | blind) * view.depth / view.camera.K[0, 0]
    thickness = np.minimum(parameters.thickness, parameters.thickness_share * width + parameters.depth_margin)
    front = view.depth * (1 - parameters.depth_share) - parameters.depth_margin
    back = np.minimum(view.depth + thickness, backdrop + parameters.depth_margin)
    kernel = _disk(error_pixels)
    begin = cv2.erode(np.where(found, front, _ALWAYS).astype(np.float32), kernel)
    end = cv2.dilate(np.where(found, back, _NEVER).astype(np.float32), kernel)
    # where a near and a far thing meet in the image, what lies between them is part of neither
    begin = np.where(found, np.maximum(begin, front - _SLANT_M), begin)
    end = np.where(found, np.minimum(end, back + _SLANT_M), np.minimum(end, begin + parameters.thickness + _SLANT_M))
    end = np.where(blind, _NEVER, end)
    return Surface(np.append(begin, _ALWAYS).astype(np.float32), np.append(end, _NEVER).astype(np.float32))


def _without_specks(mask: Bool, least: int = _SPECK) -> Bool:
    """A mask [H, W] without its blobs of fewer than `least` pixels."""
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    window = slice(top, top + height), slice(left, left + width)
    kept = np.zeros_like(mask)
    if width:
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask[window].astype(np.uint8))
        kept[window] = mask[window] & (stats[:, cv2.CC_STAT_AREA] >= least)[labels]
    return kept


def _local_radius(mask: Bool) -> Float32:
    """[H, W] upper bound of the radius in pixels of the largest disk inside the mask that holds each pixel."""
    radius = np.zeros(mask.shape, np.float32)
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    # with a rim of one pixel: only the image's own sides do not count as edges of the mask
    rows, columns = slice(max(top - 1, 0), top + height + 1), slice(max(left - 1, 0), left + width + 1)
    radius[rows, columns] = _radius_within(mask[rows, columns])
    return radius


def _radius_within(mask: Bool) -> Float32:
    radius = np.where(mask, np.float32(_RADII[0]), np.float32(0))
    depth_inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    for smaller, larger in itertools.pairwise(_RADII):
        middles = depth_inside >= smaller
        if not middles.any():
            break
        reached = cv2.distanceTransform((~middles).astype(np.uint8), cv2.DIST_L2, 3) <= larger
        radius = np.where(reached & mask, np.float32(larger), radius)
    return radius


def dilated(mask: Bool, pixels: float) -> Bool:
    """A mask [H, W] widened by so many pixels."""
    return cv2.dilate(mask.astype(np.uint8), _disk(pixels)) > 0 if pixels >= 1 else mask


def _disk(radius: float) -> UInt8:
    """Kernel of the pixels whose centres lie within `radius` pixels."""
    reach = int(radius)
    offsets = np.arange(-reach, reach + 1)
    return (np.hypot(offsets[:, None], offsets) <= radius).astype(np.uint8)
