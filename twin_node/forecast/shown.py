"""What the images of one view show of parts that move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.image_motion import Shifts
from twin_node.forecast.kernel_requests import ShowRequest, TellRequest
from twin_node.forecast.kernels import kernels
from twin_node.forecast.parts import PART_SIZE
from twin_node.forecast.tables import CameraTable
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float64


@dataclass(frozen=True)
class Visible:
    """Voxels of parts that a view shows to move."""

    pixels: NDArray[np.int64]
    """[n] flat."""
    labels: NDArray[np.int64]
    """[n] part of each."""


def visible(moving: Bool, table: CameraTable, places: NDArray[np.int64], labels: NDArray[np.int64]) -> Visible:
    """Those of the voxels at `places` [n] that are nearest to the camera, where the mask shows something moving.

    Compiled; `visible_plainly` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return visible_plainly(moving, table, places, labels)
    given = (
        places,
        np.ascontiguousarray(labels),
        table.voxels.pixels,
        table.voxels.depth,
        np.ascontiguousarray(moving),
    )
    pixels, shown, count = np.empty(len(places), np.int64), np.empty(len(places), np.int64), np.zeros(1, np.int64)
    addresses = addresses_of(*given, pixels, shown, count)
    compiled.show(ShowRequest(len(places), table.camera.width, table.camera.height, PART_SIZE, *addresses))
    return Visible(pixels[: count[0]], shown[: count[0]])


def visible_plainly(moving: Bool, table: CameraTable, places: NDArray[np.int64], labels: NDArray[np.int64]) -> Visible:
    """What `visible` does."""
    seen = table.at(places)
    inside = seen.pixels < table.outside
    pixels = np.where(inside, seen.pixels, 0)
    width, height = table.camera.width, table.camera.height
    rows, columns = pixels // width // 2, pixels % width // 2
    nearest = np.full((height // 2 + 1, width // 2 + 1), np.inf, np.float32)
    np.minimum.at(nearest, (rows, columns), np.where(inside, seen.depth, np.inf).astype(np.float32))
    shown = inside & (seen.depth < nearest[rows, columns] + PART_SIZE) & moving.ravel()[pixels]
    return Visible(pixels[shown].astype(np.int64), labels[shown])


@dataclass(frozen=True)
class Told:
    """What the pixels of each of M parts show on average."""

    shifts: Float64
    """[M, 2] pixels moved: what moves in a pixel counts for more than what stands still beside it."""
    shown: Bool
    """[M] whether any pixel shows it."""
    known: Bool
    """[M] whether enough of them showed it in the image before."""
    flies: Bool
    """[M] whether most of them were found as a whole, not by flow."""
    receded: Float64
    """[M] m by which it went away from the camera; 0 where that is not known."""
    depths: Float64
    """[M] m; infinite where they are not known."""


def told(shifts: Shifts, seen: Visible, count: int) -> Told:
    """What the visible voxels show of `count` parts. Compiled; `told_plainly` where that cannot be."""
    compiled = kernels()
    if compiled is None:
        return told_plainly(shifts, seen, count)
    masks = tuple(np.ascontiguousarray(mask) for mask in (shifts.found, shifts.flying))
    depths = (shifts.receded, shifts.depth) if shifts.receded is not None else (None, None)
    images = (shifts.pixels, *depths)
    given = (None if image is None else np.ascontiguousarray(image, np.float32) for image in images)
    found = Told(np.empty((count, 2)), *np.empty((3, count), np.bool_), *np.empty((2, count)))
    results = (found.shifts, found.shown, found.known, found.flies, found.receded, found.depths)
    arrays: tuple[NDArray[np.generic] | None, ...] = (seen.pixels, seen.labels, *masks, *given, *results)
    lengths = (_FLOW_NOISE, _FASTEST * shifts.elapsed_s, _KNOWN, _LEAST)
    compiled.tell(TellRequest(len(seen.pixels), count, _FEWEST, *lengths, *addresses_of(*arrays)))
    return found


def told_plainly(shifts: Shifts, seen: Visible, count: int) -> Told:
    """What `told` does."""
    pixels, labels = seen.pixels, seen.labels
    found = shifts.found.ravel()[pixels]
    moved = shifts.pixels.reshape(-1, 2)[pixels]
    weight = found * (np.linalg.norm(moved, axis=1) + _FLOW_NOISE) ** 2
    receded, depths = _recession(shifts, seen, count)
    return Told(
        np.stack([_mean(labels, moved[:, axis], weight, count) for axis in range(2)], axis=1),
        np.bincount(labels, minlength=count) > 0,
        np.bincount(labels, found, minlength=count) > _KNOWN * np.bincount(labels, minlength=count),
        _mean(labels, shifts.flying.ravel()[pixels], np.ones(len(labels)), count) > 0.5,
        receded,
        depths,
    )


def _recession(shifts: Shifts, seen: Visible, count: int) -> tuple[Float64, Float64]:
    """By how much `count` parts went away from the camera, and their depth, m; infinite where that is not known."""
    unknown = np.zeros(count), np.full(count, np.inf)
    if shifts.receded is None or shifts.depth is None:
        return unknown
    receded, depth = shifts.receded.ravel()[seen.pixels], shifts.depth.ravel()[seen.pixels]
    # what went further is another surface, in front or behind
    sound = np.abs(receded) < _FASTEST * shifts.elapsed_s
    labels = seen.labels[sound]
    shown = np.bincount(labels, minlength=count) >= _FEWEST
    mean = _mean(labels, receded[sound], np.ones(len(labels)), count)
    depths = np.where(shown, _mean(labels, depth[sound], np.ones(len(labels)), count), np.inf)
    return np.where(shown, mean, 0.0), depths


def _mean(
    labels: NDArray[np.int64], values: NDArray[np.floating[Any] | np.bool_], weights: Float64, count: int
) -> Float64:
    """[count] weighted means of values [n] by labels [n]; 0 for none."""
    total = np.bincount(labels, weights, count)
    mean: Float64 = np.bincount(labels, weights * values, count) / np.maximum(total, _LEAST)
    return mean


_FLOW_NOISE = 0.1
"""Noise of optical flow, pixels: weights favour the pixels that move, for the hull holds still ones too."""
_FASTEST = 8.0
"""Along the optical axis what goes faster is taken for another surface, m/s."""
_KNOWN = 0.3
"""Share of a part's pixels that must be found in the image before."""
_FEWEST = 2
"""Voxels that must have been measured to know a part's depth."""
_LEAST = 1e-9
"""Weights are taken for no less: means of nothing are 0."""
