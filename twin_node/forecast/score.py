"""How good a forecast was, against what turned out to be true: recall, volume, overlap in the images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.grid import decode_runs
from twin_node.geometry import project
from twin_node.scene import Bool, Camera, Float64, Grid, Occupancy, OccupancyLayer

HUE_TOLERANCE = 10
"""Half degrees either side."""
LEAST_COLOUR = (130, 90)
"""Saturation and value, 0 to 255, below which no pixel has a colour to speak of."""


@dataclass(frozen=True)
class PointScore:
    """How many points that turned out to be occupied a layer held."""

    found: int
    """Points inside the layer."""
    of: int
    """Points that lie in the grid at all."""
    new_found: int
    """Points inside the layer whose voxel was not seen to be occupied when the forecast was made."""
    new_of: int
    """All points whose voxel was not."""


def score_points(grid: Grid, forecast: NDArray[np.integer], points: Float64, before: NDArray[np.integer]) -> PointScore:
    """Scores voxels `forecast` [k] (flat indices) against points [n, 3] (m) that are occupied at their time.

    `before` [m]: voxels occupied already. Points that are not finite or outside the grid do not count.
    """
    finite = points[np.isfinite(points).all(axis=1)]
    places = grid.indices(finite)
    places = places[places >= 0]
    held = contains(grid, forecast, places)
    new = ~contains(grid, before, places)
    return PointScore(int(held.sum()), len(places), int((held & new).sum()), int(new.sum()))


def contains(grid: Grid, indices: NDArray[np.integer], places: NDArray[np.integer]) -> Bool:
    """Whether each flat index in `places` [n] is among `indices` [m]."""
    marked = np.zeros(grid.size, np.bool_)
    marked[indices] = True
    held: Bool = marked[places]
    return held


def blocked_volume(occupancy: Occupancy, layer: OccupancyLayer) -> float:
    """Litres that a reader may not enter for the sake of what moves: the layer, and unknown space (it is not free)."""
    blocked = decode_runs(occupancy.unknown_runs, occupancy.grid.size)
    blocked[layer.indices] = True
    return float(np.count_nonzero(blocked)) * litres_per_voxel(occupancy.grid)


def litres_per_voxel(grid: Grid) -> float:
    """Volume of a voxel."""
    return grid.voxel_size**3 * 1e3


def projected(camera: Camera, grid: Grid, indices: NDArray[np.integer]) -> Bool:
    """[H, W] True where voxels `indices` [n] show in an image: each a square of its width."""
    u, v, z = project(camera.K, camera.viewmat, grid.centers(indices)).T
    half = camera.K[0, 0] * grid.voxel_size / np.maximum(2 * z, 1e-6)
    inside = (z > grid.voxel_size) & (u > -half) & (v > -half) & (u < camera.width + half) & (v < camera.height + half)
    u, v, half = u[inside], v[inside], half[inside]
    left, right = _span(u, half, camera.width)
    top, bottom = _span(v, half, camera.height)
    corners = np.zeros((camera.height + 1, camera.width + 1), np.int32)
    for rows, columns, sign in ((top, left, 1), (bottom, right, 1), (top, right, -1), (bottom, left, -1)):
        np.add.at(corners, (rows, columns), sign)
    covered: Bool = np.cumsum(np.cumsum(corners, axis=0), axis=1)[:-1, :-1] > 0
    return covered


def _span(middle: Float64, half: Float64, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First pixel and one past the last that an interval about `middle` touches, inside [0, size]."""
    first = np.clip(np.floor(middle - half), 0, size).astype(np.int64)
    last = np.clip(np.ceil(middle + half), 0, size).astype(np.int64)
    return first, last


def iou(predicted: Bool, truth: Bool) -> float:
    """Intersection over union of two masks; NaN where both are empty."""
    union = np.count_nonzero(predicted | truth)
    return float(np.count_nonzero(predicted & truth) / union) if union else float("nan")


def nearest_error(grid: Grid, layer: OccupancyLayer, points: Float64) -> Float64:
    """Distances [n] in metres from points [m, 3] to the nearest voxel centre of the layer; 0 inside it.

    Points that are not finite or outside the grid are left out; infinite where the layer is empty.
    """
    from scipy.spatial import cKDTree  # loads slowly, and who only reads parameters never asks

    finite = points[np.isfinite(points).all(axis=1)]
    places = grid.indices(finite)
    kept = np.flatnonzero(places >= 0)
    held = contains(grid, layer.indices, places[kept])
    errors = np.zeros(len(kept))
    if not held.all():
        centers = grid.centers(layer.indices)
        errors[~held] = cKDTree(centers).query(finite[kept[~held]])[0] if len(centers) else np.inf
    return errors


def colour_mask(rgb: NDArray[np.uint8], hue: int) -> Bool:
    """[H, W] pixels of one colour, neither pale nor dark: hue in OpenCV's half degrees, orange 8."""
    hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV).astype(np.int32)
    off = np.abs(hsv[..., 0] - hue)
    chosen: Bool = (np.minimum(off, 180 - off) <= HUE_TOLERANCE) & (hsv[..., 1:] >= LEAST_COLOUR).all(-1)
    return chosen
