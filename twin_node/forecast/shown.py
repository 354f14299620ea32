"""What the images of one view show of parts that move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.agreement import Sighting
from twin_node.forecast.blobs import FLIGHT, FOUND, SAME_AREA
from twin_node.forecast.image_motion import ALIKE_GREY, Image, Pair, Shifts, shifts_plainly
from twin_node.forecast.kernel_requests import SeenImage, ShowRequest, TellRequest
from twin_node.forecast.kernels import kernels
from twin_node.forecast.parts import PART_SIZE
from twin_node.forecast.tables import CameraTable
from twin_node.geometry import transform
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Camera, Float64


@dataclass(frozen=True)
class Sample:
    """Some voxels of M parts."""

    places: NDArray[np.int64]
    """[n] in the tables (`Blocks.locate`)."""
    labels: NDArray[np.int64]
    """[n] part of each."""
    centers: Float64
    """[M, 3] m, of the parts."""


@dataclass(frozen=True)
class Visible:
    """Voxels of M parts that a view shows to move."""

    pixels: NDArray[np.int64]
    """[n] flat."""
    labels: NDArray[np.int64]
    """[n] part of each."""
    jacobian: Float64
    """[M, 2, 3] how the pixel of each part's middle moves with it, pixels per metre."""


def visible(moving: Bool, table: CameraTable, sample: Sample) -> Visible:
    """Those voxels of a sample that are nearest to the camera, where the mask shows something moving.

    Compiled; `visible_plainly` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return visible_plainly(moving, table, sample)
    camera, count = table.camera, np.zeros(1, np.int64)
    given: tuple[NDArray[Any], ...] = (
        *(np.ascontiguousarray(array) for array in (sample.places, sample.labels)),
        *(table.voxels.pixels, table.voxels.depth),
        *(np.ascontiguousarray(array) for array in (moving, sample.centers)),
    )
    pixels, labels = np.empty((2, len(sample.places)), np.int64)
    jacobian = np.empty((len(sample.centers), 2, 3))
    focal, viewmat = (camera.K[0, 0], camera.K[1, 1]), tuple(camera.viewmat[:3].ravel().tolist())
    sizes = (len(sample.places), len(sample.centers), camera.width, camera.height, PART_SIZE, _LEAST_DEPTH)
    addresses = addresses_of(*given, pixels, labels, count, jacobian)
    compiled.show(ShowRequest(*sizes, focal, viewmat, *addresses))
    return Visible(pixels[: count[0]], labels[: count[0]], jacobian)


def visible_plainly(moving: Bool, table: CameraTable, sample: Sample) -> Visible:
    """What `visible` does."""
    seen = table.at(sample.places)
    inside = seen.pixels < table.outside
    pixels = np.where(inside, seen.pixels, 0)
    width, height = table.camera.width, table.camera.height
    rows, columns = pixels // width // 2, pixels % width // 2
    nearest = np.full((height // 2 + 1, width // 2 + 1), np.inf, np.float32)
    np.minimum.at(nearest, (rows, columns), np.where(inside, seen.depth, np.inf).astype(np.float32))
    shown = inside & (seen.depth < nearest[rows, columns] + PART_SIZE) & moving.ravel()[pixels]
    jacobian = _jacobian(table.camera, sample.centers)
    return Visible(pixels[shown].astype(np.int64), sample.labels[shown], jacobian)


def _jacobian(camera: Camera, points: Float64) -> Float64:
    """Derivative [M, 2, 3] of the pixel by the base-frame point."""
    x, y, z = transform(camera.viewmat, points).T
    z = np.maximum(z, _LEAST_DEPTH)
    right, down, ahead = camera.viewmat[:3, :3]
    rows = np.empty((len(points), 2, 3))
    rows[:, 0] = (camera.K[0, 0] / z)[:, None] * (right - (x / z)[:, None] * ahead)
    rows[:, 1] = (camera.K[1, 1] / z)[:, None] * (down - (y / z)[:, None] * ahead)
    return rows


def told(pair: Pair, seen: Visible, axis: Float64) -> Sighting:
    """What two images of a view with the optical `axis` [3] show of the parts, by the mean over their pixels.

    What moves in a pixel counts for more than what stands still beside it. Compiled; `told_plainly` where that cannot
    be.
    """
    compiled = kernels()
    if compiled is None:
        return told_plainly(pair, seen, axis)
    count, (height, width) = len(seen.jacobian), pair.now.grey.shape
    found = Sighting(
        pair.elapsed_s,
        seen.jacobian,
        np.empty((count, 2)),
        np.empty(count),
        np.empty(count, np.bool_),
        axis,
        *np.empty((2, count)),
    )
    window = pair.window
    flow = (window.left, window.top, window.right - window.left, window.bottom - window.top)
    lengths = (_FLOW_NOISE, _FASTEST * pair.elapsed_s, _KNOWN, _LEAST, SAME_AREA, FOUND, FLIGHT)
    errors = (_FLOW_SIGMA, _FLIGHT_SIGMA, _FAST * pair.elapsed_s, _LOST)
    images = (_request(image, pair.has_depth) for image in (pair.now, pair.before))
    results = (found.shifts, found.variances, found.shown, found.receded, found.depths)
    addresses = addresses_of(pair.flow, seen.pixels, seen.labels, seen.jacobian, *results)
    sizes = (len(seen.pixels), count, _FEWEST, width, height, ALIKE_GREY, *flow)
    compiled.tell(TellRequest(*sizes, *lengths, *errors, *images, *addresses))
    return found


def _request(image: Image, with_depth: bool) -> SeenImage:
    depth, compact = image.depth if with_depth else None, image.blobs.compact
    return SeenImage(*addresses_of(image.grey, image.moving, image.blobs.labels, compact, depth), len(compact))


def told_plainly(pair: Pair, seen: Visible, axis: Float64) -> Sighting:
    """What `told` does."""
    shifts, count = shifts_plainly(pair), len(seen.jacobian)
    pixels, labels = seen.pixels, seen.labels
    found = shifts.found.ravel()[pixels]
    moved = shifts.pixels.reshape(-1, 2)[pixels]
    weight = found * (np.linalg.norm(moved, axis=1) + _FLOW_NOISE) ** 2
    known = np.bincount(labels, found, minlength=count) > _KNOWN * np.bincount(labels, minlength=count)
    flies = _mean(labels, shifts.flying.ravel()[pixels], np.ones(len(labels)), count) > 0.5
    return Sighting(
        pair.elapsed_s,
        seen.jacobian,
        np.stack([_mean(labels, moved[:, axis], weight, count) for axis in range(2)], axis=1),
        np.where(known, _variances(seen.jacobian, pair.elapsed_s, flies), np.inf),
        np.bincount(labels, minlength=count) > 0,
        axis,
        *_recession(pair, shifts, seen),
    )


def _variances(jacobian: Float64, elapsed_s: float, flies: Bool) -> Float64:
    """[M] pixels^2: what is near moves far between two images, and flow does not find it again."""
    reach = np.linalg.norm(jacobian, axis=(1, 2)) / np.sqrt(2) * (_FAST * elapsed_s)
    flow = _FLOW_SIGMA * (1 + (reach / _LOST) ** 3)
    variances: Float64 = np.where(flies, _FLIGHT_SIGMA, flow) ** 2
    return variances


def _recession(pair: Pair, shifts: Shifts, seen: Visible) -> tuple[Float64, Float64]:
    """By how much parts [M] went away from the camera, and their depth, m; infinite where that is not known."""
    count = len(seen.jacobian)
    if shifts.receded is None or pair.now.depth is None:
        return np.zeros(count), np.full(count, np.inf)
    receded, depth = shifts.receded.ravel()[seen.pixels], pair.now.depth.ravel()[seen.pixels]
    # what went further is another surface, in front or behind
    sound = np.abs(receded) < _FASTEST * pair.elapsed_s
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


_LEAST_DEPTH = 0.05
"""Parts are taken for no nearer to the camera, m."""
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
_FLOW_SIGMA = 0.3
"""Error of the flow of a part, pixels (measured on the simulated cell: 0.2 to 0.4)."""
_FLIGHT_SIGMA = 0.7
"""Error of the way of a small thing that is found as a whole, pixels: masks are no sharper."""
_FAST, _LOST = 2.0, 12.0
"""Flow is as good as noise where what moves at the first, m/s, has gone much more than the second, pixels."""
