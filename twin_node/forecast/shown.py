"""What the images of one view show of parts that move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.agreement import Sighting
from twin_node.forecast.blobs import FLIGHT, FOUND, SAME_AREA
from twin_node.forecast.image_motion import ALIKE_GREY, Image, Pair, Shifts, shifts_reference
from twin_node.forecast.kernels import kernels
from twin_node.forecast.part_requests import SeenImage, ShowRequest, ShowRequests, TellRequest, TellRequests
from twin_node.forecast.parts import PART_SIZE
from twin_node.forecast.tables import CameraTable
from twin_node.geometry import transform
from twin_node.native_library import addresses_of, array_of, thread_count
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


def visible(moving: Sequence[Bool], tables: Sequence[CameraTable], sample: Sample) -> list[Visible]:
    """Those voxels of a sample that are nearest to each camera, where its mask shows something moving.

    Compiled; `visible_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return [visible_reference(*one, sample) for one in zip(moving, tables, strict=True)]
    voxels, parts = len(sample.places), len(sample.centers)
    places, labels, centers = (np.ascontiguousarray(array) for array in (sample.places, sample.labels, sample.centers))
    pixels, mine = np.empty((2, len(tables), voxels), np.int64)
    counts, jacobians = np.zeros((len(tables), 1), np.int64), np.empty((len(tables), parts, 2, 3))
    held, requests = [], []
    for row, (mask, table) in enumerate(zip(moving, tables, strict=True)):
        camera, seen = table.camera, table.voxels
        given = (places, labels, seen.pixels, seen.depth, np.ascontiguousarray(mask), centers)
        arrays: tuple[NDArray[Any], ...] = (*given, pixels[row], mine[row], counts[row], jacobians[row])
        focal, viewmat = (camera.K[0, 0], camera.K[1, 1]), tuple(camera.viewmat[:3].ravel().tolist())
        sizes = (voxels, parts, camera.width, camera.height, PART_SIZE, _LEAST_DEPTH)
        requests.append(ShowRequest(*sizes, focal, viewmat, *addresses_of(*arrays)))
        held.append(arrays)  # alive until the call is over
    compiled.run(ShowRequests(len(requests), thread_count(), array_of(ShowRequest, requests)))
    ends = counts[:, 0].tolist()
    return [Visible(pixels[row, :end], mine[row, :end], jacobians[row]) for row, end in enumerate(ends)]


def visible_reference(moving: Bool, table: CameraTable, sample: Sample) -> Visible:
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


@dataclass(frozen=True)
class Witness:
    """What one view shows of parts, and its last two images."""

    pair: Pair
    visible: Visible
    """In the newer one."""
    axis: Float64
    """[3] the optical axis in the base frame."""


def told(witnesses: Sequence[Witness]) -> list[Sighting]:
    """What two images of each view show of the parts, by the mean over their pixels.

    What moves in a pixel counts for more than what stands still beside it. Compiled; `told_reference` where that cannot
    be.
    """
    compiled = kernels()
    if compiled is None:
        return [told_reference(witness) for witness in witnesses]
    found = [_room(witness) for witness in witnesses]
    requests = array_of(TellRequest, [_told_by(*one) for one in zip(witnesses, found, strict=True)])
    compiled.run(TellRequests(len(witnesses), thread_count(), requests))
    return found


def _room(witness: Witness) -> Sighting:
    """Arrays for what a view says."""
    jacobian = witness.visible.jacobian
    count = len(jacobian)
    shown, (variances, receded, depths) = np.empty(count, np.bool_), np.empty((3, count))
    told_s = witness.pair.elapsed_s
    return Sighting(told_s, jacobian, np.empty((count, 2)), variances, shown, witness.axis, receded, depths)


def _told_by(witness: Witness, found: Sighting) -> TellRequest:
    pair, seen = witness.pair, witness.visible
    count, (height, width) = len(seen.jacobian), pair.now.grey.shape
    window = pair.window
    flow = (window.left, window.top, window.right - window.left, window.bottom - window.top)
    lengths = (_FLOW_NOISE, _FASTEST * pair.elapsed_s, _KNOWN, _LEAST, SAME_AREA, FOUND, FLIGHT)
    errors = (_FLOW_SIGMA, _FLIGHT_SIGMA, _FAST * pair.elapsed_s, _LOST)
    images = (_request(image, pair.has_depth) for image in (pair.now, pair.before))
    results = (found.shifts, found.variances, found.shown, found.receded, found.depths)
    addresses = addresses_of(pair.flow, seen.pixels, seen.labels, seen.jacobian, *results)
    sizes = (len(seen.pixels), count, _FEWEST, width, height, ALIKE_GREY, *flow)
    return TellRequest(*sizes, *lengths, *errors, *images, *addresses)


def _request(image: Image, with_depth: bool) -> SeenImage:
    depth, compact = image.depth if with_depth else None, image.blobs.compact
    return SeenImage(*addresses_of(image.grey, image.moving, image.blobs.labels, compact, depth), len(compact))


def told_reference(witness: Witness) -> Sighting:
    """What `told` does with one view."""
    pair, seen, axis = witness.pair, witness.visible, witness.axis
    shifts, count = shifts_reference(pair), len(seen.jacobian)
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
