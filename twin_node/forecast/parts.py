"""Parts of the moving space and how they move: the nodes of a rig that has images and no model yet."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin_node.forecast.growth import Points
from twin_node.forecast.tables import CameraTable, RigTables
from twin_node.geometry import transform
from twin_node.scene import Bool, Camera, Float32, Float64, Grid, TwinState, UInt8, View

PART_SIZE = 0.08
"""Edge of a part, m: about as thick as a forearm, so that limbs and torso get parts of their own."""


@dataclass(frozen=True)
class Parts:
    """Moving voxels in cubes of about `PART_SIZE`."""

    indices: NDArray[np.int64]
    """[n] flat voxel indices."""
    places: NDArray[np.int32]
    """[3, n] voxel coordinates (i, j, k)."""
    labels: NDArray[np.int64]
    """[n] part of each voxel."""
    likely: Bool
    """[n] voxels that are occupied more likely than not; the others are rims that errors add."""
    centers: Float64
    """[M, 3] mean of each part's voxels, m."""

    @property
    def points(self) -> Points:
        """The voxels as growth takes them: the likely ones are cores."""
        return Points(self.places, self.labels, self.likely)

    @property
    def count(self) -> int:
        """M, the number of parts."""
        return len(self.centers)


def split(grid: Grid, indices: NDArray[np.int64], likely: Bool) -> Parts:
    """Parts of the voxels `indices` [n], `likely` [n] occupied: one per occupied cell of a coarser lattice."""
    side = max(1, round(PART_SIZE / grid.voxel_size))
    lattice = tuple(-(-n // side) for n in grid.dims)
    places = np.stack(np.unravel_index(indices, grid.dims)).astype(np.int32)
    cells = np.ravel_multi_index(tuple(places // side), lattice)
    counts = np.bincount(cells, minlength=int(np.prod(lattice)))
    occupied = np.flatnonzero(counts)
    numbers = np.zeros(len(counts), np.int64)
    numbers[occupied] = np.arange(len(occupied))
    sums = np.stack([np.bincount(cells, axis, len(counts))[occupied] for axis in places], axis=1)
    centers = grid.origin + (sums / counts[occupied, None] + 0.5) * grid.voxel_size
    return Parts(indices, places, numbers[cells], likely, centers)


class PartVelocities:
    """Velocities of parts from the optical flow of the views that see them."""

    def __init__(self, tables: RigTables) -> None:
        self._tables = tables
        self._last: dict[str, tuple[int, UInt8]] = {}
        # Without refinement: it smears motion over what stands beside, and takes half of the time.
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._flow.setFinestScale(0)

    def update(self, state: TwinState, parts: Parts, expected: Float64) -> Float64:
        """Velocities [M, 3] in m/s; `expected` [M, 3] stands where, and along directions that, no view shows.

        Least squares over the views: the image velocity of a part is its velocity seen through the projection.
        """
        chosen = slice(None, None, _SAMPLING)
        places = self._tables.blocks.locate(parts.indices[chosen])
        sample = _Sample(places, parts.labels[chosen], parts.count)
        precision: Float64 = np.tile(np.eye(3) * _PRIOR, (parts.count, 1, 1))
        evidence: Float64 = expected * _PRIOR
        measured = np.zeros(parts.count, np.bool_)
        for view, mask, robot in zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True):
            image_velocity = self._image_velocity(view, mask)
            if image_velocity is None or parts.count == 0:
                continue
            clear = mask if robot is None else mask & ~_near(robot, _OCCLUSION_PIXELS)
            seen = _seen_by(view, image_velocity, clear, self._tables.of(view.camera), sample)
            measured |= seen.weights > 0
            jacobian = _jacobian(view.camera, parts.centers)
            scaled = jacobian * seen.weights[:, None, None]
            precision = precision + np.einsum("mki,mkj->mij", scaled, jacobian)
            evidence = evidence + np.einsum("mki,mk->mi", scaled, seen.velocities)
        velocities: Float64 = np.linalg.solve(precision, evidence[..., None]).astype(np.float64)[..., 0]
        return _filled(parts.centers, velocities, measured)

    def _image_velocity(self, view: View, mask: Bool) -> Float32 | None:
        """[H, W, 2] pixels per second, on what moves alone; None without an earlier image.

        All else is painted grey first: still ground would hold back the flow of thin limbs.
        """
        grey = np.where(_near(mask, 1), cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY), _GREY).astype(np.uint8)
        last = self._last.get(view.camera.name)
        self._last[view.camera.name] = (view.stamp, grey)
        if last is None or last[0] >= view.stamp or last[1].shape != grey.shape:
            return None
        velocity = np.zeros((*grey.shape, 2), np.float32)
        window = _window((grey != _GREY) | (last[1] != _GREY))
        if window is not None:
            now, before = np.ascontiguousarray(grey[window]), np.ascontiguousarray(last[1][window])
            flow = self._flow.calc(now, before, _blob_shifts(now, before))
            velocity[window] = flow / (-1e-9 * (view.stamp - last[0]))
        return velocity


_GREY = np.uint8(128)
_SMALLEST_WINDOW = 32
"""Side in pixels of the smallest image that optical flow is computed on: two coarse patches."""


def _blob_shifts(now: UInt8, before: UInt8) -> Float32:
    """[H, W, 2] pixels from each flying blob to where it was before; 0 elsewhere.

    Where flow begins its search: small things fly further between two images than it looks.
    """
    shifts = np.zeros((*now.shape, 2), np.float32)
    labels, mine = _blobs(now)
    _, others = _blobs(before)
    if len(mine.areas) == 0 or len(others.areas) == 0:
        return shifts
    ways = others.middles[None] - mine.middles[:, None]
    widths = np.sqrt(mine.areas)[:, None]
    alike = np.maximum(mine.areas[:, None], others.areas) < _ALIKE * np.minimum(mine.areas[:, None], others.areas)
    shares = np.where(alike, np.linalg.norm(ways, axis=2) / widths, np.inf)
    for blob, other in enumerate(shares.argmin(axis=1).tolist()):
        if _FOUND < shares[blob, other] < _FLIGHT and shares[:, other].argmin() == blob:
            shifts[labels == mine.numbers[blob]] = ways[blob, other]
    return shifts


@dataclass(frozen=True)
class _Blobs:
    """Compact blobs of what moves in one image."""

    numbers: NDArray[np.int64]
    """[b] their labels."""
    areas: Float64
    """[b] pixels."""
    middles: Float64
    """[b, 2] pixels."""


def _blobs(grey: UInt8) -> tuple[NDArray[np.int32], _Blobs]:
    """Labels [H, W], and the blobs that fill most of a box about them: bodies and their rims are none."""
    _, labels, stats, middles = cv2.connectedComponentsWithStats((grey != _GREY).astype(np.uint8))
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.float64)
    width, height = stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]
    compact = (areas >= _SMALLEST_BLOB) & (areas > _COMPACT * np.maximum(width, height) ** 2)
    numbers = np.flatnonzero(compact[1:]) + 1
    return labels.astype(np.int32, copy=False), _Blobs(numbers, areas[numbers], middles[numbers])


_SMALLEST_BLOB = 12
"""Pixels; smaller blobs come and go."""
_COMPACT = 0.5
"""Share of the square about it that a blob fills at least; a disk fills 0.79."""
_ALIKE = 1.6
"""A blob is taken for another of at most so many times its area."""
_FOUND, _FLIGHT = 0.3, 3.0
"""Blobs that came by more than the first and less than the second of these times their width since the last image
are given a start: flow finds nearer ones itself, and limbs of a body better. 3: a ball of 0.1 m at 9 m/s and 30 Hz."""


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


def _near(mask: Bool, pixels: int) -> Bool:
    """The pixels of a mask and so many about them."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * pixels + 1,) * 2, np.uint8)) > 0


def _filled(centers: Float64, velocities: Float64, measured: Bool) -> Float64:
    """Velocities [M, 3] in which parts that no view shows move as the nearest one that some view shows."""
    hidden = np.flatnonzero(~measured)
    if len(hidden) == 0 or not measured.any():
        return velocities
    shown = np.flatnonzero(measured)
    distances, rows = cKDTree(centers[shown]).query(centers[hidden], distance_upper_bound=_BODY_M)
    attached = np.isfinite(distances)
    filled = velocities.copy()
    filled[hidden[attached]] = velocities[shown[rows[attached]]]
    return filled


_BODY_M = 0.3
"""What no view shows belongs to what is seen within this distance, m: a torso from front to back."""
_OCCLUSION_PIXELS = 4
"""Beside the arm the flow is that of its outline over what it hides: half a patch of the coarsest level's."""
_FLOW_NOISE = 3.0
"""Noise of optical flow, pixels per second: weights favour the pixels that move, for the hull holds still ones too."""
_SAMPLING = 3
"""One voxel in so many is looked up in the images: a part has about 64."""


@dataclass(frozen=True)
class _Sample:
    """Some voxels of all parts."""

    places: NDArray[np.int64]
    labels: NDArray[np.int64]
    count: int


@dataclass(frozen=True)
class _Seen:
    """Image velocities [M, 2] of parts in one view, and weights [M]: 1 for the parts that it shows, else 0."""

    velocities: Float64
    weights: Float64


_PRIOR = 500.0
"""Weight of the expected velocity against one view: (pixels per metre)^2, as of a view from 6 m."""


def _seen_by(view: View, image_velocity: Float32, mask: Bool, table: CameraTable, sample: _Sample) -> _Seen:
    """What the view shows of each part: the voxels nearest to the camera, where the mask shows something moving."""
    seen = table.at(sample.places)
    inside = seen.pixels < table.outside
    pixels = np.where(inside, seen.pixels, 0)
    rows, columns = pixels // view.camera.width // 2, pixels % view.camera.width // 2
    nearest = np.full((view.camera.height // 2 + 1, view.camera.width // 2 + 1), np.inf, np.float32)
    np.minimum.at(nearest, (rows, columns), np.where(inside, seen.depth, np.inf).astype(np.float32))
    visible = inside & (seen.depth < nearest[rows, columns] + PART_SIZE) & mask.ravel()[pixels]
    velocity = image_velocity.reshape(-1, 2)[pixels]
    weight = visible * (np.linalg.norm(velocity, axis=1) + _FLOW_NOISE) ** 2
    total = np.bincount(sample.labels, weight, sample.count)
    sums = [np.bincount(sample.labels, weight * velocity[:, axis], sample.count) for axis in range(2)]
    return _Seen(np.stack(sums, axis=1) / np.maximum(total, 1e-9)[:, None], (total > 0).astype(np.float64))


def _jacobian(camera: Camera, points: Float64) -> Float64:
    """Derivative [M, 2, 3] of the pixel by the base-frame point."""
    x, y, z = transform(camera.viewmat, points).T
    z = np.maximum(z, 0.05)
    rows = np.zeros((len(points), 2, 3))
    rows[:, 0, 0], rows[:, 0, 2] = camera.K[0, 0] / z, -camera.K[0, 0] * x / z**2
    rows[:, 1, 1], rows[:, 1, 2] = camera.K[1, 1] / z, -camera.K[1, 1] * y / z**2
    return rows @ camera.viewmat[:3, :3]
