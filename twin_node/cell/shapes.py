"""Primitive solids: where a ray enters them, which way their surface faces, which voxels they touch."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import transform
from twin_node.scene import Bool, Float32, Float64, Grid


class Form(Enum):
    """What a solid looks like in its own frame, whose origin is its centre."""

    SPHERE = "sphere"
    CAPSULE = "capsule"
    BOX = "box"


@dataclass(frozen=True)
class Shape:
    """A primitive solid about the origin of its own frame."""

    form: Form
    size: tuple[float, ...]
    """m; sphere: radius; capsule: radius, distance of the two end centres (along z); box: full extents in x, y, z."""

    @property
    def lengths(self) -> tuple[float, float, float]:
        """m; box: half extents; else: radius, half the distance of the end centres, 0."""
        if self.form is Form.BOX:
            x, y, z = self.size
            return x / 2, y / 2, z / 2
        return self.size[0], self.size[1] / 2 if self.form is Form.CAPSULE else 0.0, 0.0

    @property
    def half_extents(self) -> Float64:
        """[3] half the sides of the smallest box about the shape in its own frame, m."""
        first, second, third = self.lengths
        return np.array((first, second, third) if self.form is Form.BOX else (first, first, first + second))


SIGNS = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(8, 3)
"""[8, 3] corners of a cube."""


@dataclass(frozen=True)
class Placed:
    """A shape at a pose, in `base_link` unless said otherwise."""

    shape: Shape
    T_base_shape: Float64
    """[4, 4] maps the shape's coordinates to `base_link`."""

    @property
    def corners(self) -> Float64:
        """[8, 3] corners in `base_link` of the shape's own smallest box, m."""
        return transform(self.T_base_shape, SIGNS * self.shape.half_extents)


def ray_entries(shape: Shape, origin: Float32, directions: Float32) -> Float32:
    """Ray parameters [n] at which rays origin [3] + t * directions [3, n] enter the shape, infinite where they miss.

    Coordinates are the shape's own. Rays that start inside count as misses. In single precision round shapes are off by
    0.02 mm at 5 m, where rays graze them by 2 mm, and by as much as 14 mm at 80 m.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        lengths = np.array(shape.lengths, np.float32)
        if shape.form is Form.BOX:
            return _box_entries(lengths, origin, directions)
        if shape.form is Form.SPHERE:
            return _sphere_entries(lengths[0], origin, directions)
        return _capsule_entries(lengths[0], lengths[1], origin, directions)


def _sphere_entries(radius: np.float32, origin: Float32, directions: Float32) -> Float32:
    c = along(origin, origin) - radius * radius
    t = _nearer_root(along(directions, directions), along(origin, directions), c)
    return np.where(t > 0, t, np.float32(np.inf))


def _capsule_entries(radius: np.float32, half_length: np.float32, origin: Float32, directions: Float32) -> Float32:
    x, y, z = directions
    from_axis = origin[0] * origin[0] + origin[1] * origin[1]
    past_end = np.maximum(np.abs(origin[2]) - half_length, np.float32(0))
    if from_axis + past_end * past_end < radius * radius:
        return np.full(directions.shape[1], np.inf, np.float32)
    side = _nearer_root(x * x + y * y, origin[0] * x + origin[1] * y, from_axis - radius * radius)
    inside_side = (np.abs(origin[2] + side * z) <= half_length) & (side > 0)
    t = np.where(inside_side, side, np.float32(np.inf))
    for end in (-half_length, half_length):
        t = np.minimum(t, _sphere_entries(radius, origin - np.array([0, 0, end], np.float32), directions))
    return t


def _nearer_root(a: Float32, b: Float32, c: Float32) -> Float32:
    """The lesser t with a t^2 + 2 b t + c = 0; NaN without one."""
    root: Float32 = (-b - np.sqrt(b * b - a * c)) / a
    return root


def _box_entries(half: Float32, origin: Float32, directions: Float32) -> Float32:
    inverse = 1 / directions
    first = (-half[:, None] - origin[:, None]) * inverse
    second = (half[:, None] - origin[:, None]) * inverse
    entry = np.minimum(first, second).max(axis=0)
    leave = np.maximum(first, second).min(axis=0)
    return np.where((entry <= leave) & (entry > 0), entry, np.float32(np.inf))


def along(first: Float32, second: Float32) -> Float32:
    """Scalar products [...] of vectors [3, ...], summed in the order that the compiled kernel sums in."""
    product: Float32 = first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
    return product


def normals(shape: Shape, points: Float32) -> Float32:
    """Outward unit normals [3, n] at surface points [3, n], both in the shape's own frame."""
    lengths = np.array(shape.lengths, np.float32)
    if shape.form is Form.BOX:
        ratio = points / lengths[:, None]
        face = np.abs(ratio).argmax(axis=0)
        out = np.zeros_like(points)
        column = np.arange(points.shape[1])
        out[face, column] = np.sign(ratio[face, column])
        return out
    axis_point = np.zeros_like(points)
    if shape.form is Form.CAPSULE:
        axis_point[2] = np.clip(points[2], -lengths[1], lengths[1])
    facing: Float32 = (points - axis_point) / lengths[0]
    return facing


def touched_voxels(placed: Placed, grid: Grid) -> NDArray[np.int64]:
    """Flat indices, increasing, of the voxels of `grid` whose closed cube meets the solid."""
    low = np.ceil((placed.corners.min(axis=0) - grid.origin) / grid.voxel_size).astype(np.int64) - 1
    high = np.floor((placed.corners.max(axis=0) - grid.origin) / grid.voxel_size).astype(np.int64)
    low, high = np.maximum(low, 0), np.minimum(high, np.array(grid.dims) - 1)
    if np.any(low > high):
        return np.empty(0, np.int64)
    i, j, k = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij")
    candidates = ((i * grid.dims[1] + j) * grid.dims[2] + k).ravel()
    touched: NDArray[np.int64] = candidates[cubes_meet(placed, grid.centers(candidates), grid.voxel_size / 2)]
    return touched


def cubes_meet(placed: Placed, centers: Float64, half: float) -> Bool:
    """[n] whether axis-aligned cubes about centers [n, 3] with half side `half` (m) meet the solid."""
    if placed.shape.form is Form.BOX:
        return _boxes_meet(placed, centers, half)
    radius, half_length, _ = placed.shape.lengths
    half_axis = placed.T_base_shape[:3, 2] * half_length
    return _capsule_meets(placed.T_base_shape[:3, 3], half_axis, radius, centers, half)


def _capsule_meets(center: Float64, half_axis: Float64, radius: float, centers: Float64, half: float) -> Bool:
    offset = center - centers
    along = np.clip(-(offset @ half_axis) / max(float(half_axis @ half_axis), 1e-12), -1, 1)
    distance = np.linalg.norm(offset + along[:, None] * half_axis, axis=1)
    meets: Bool = distance <= radius + half
    corner_only = ~meets & (distance <= radius + half * np.sqrt(3))
    meets[corner_only] = _segment_to_cube(offset[corner_only], half_axis, half) <= radius
    return meets


def _segment_to_cube(offset: Float64, half_axis: Float64, half: float) -> Float64:
    """Distance [n] of segments offset [n, 3] + s * half_axis, -1 <= s <= 1, from the cube about the origin.

    The squared distance is convex in s, so its derivative is bisected; 40 halvings leave less than 1e-12 of the length.
    """
    low, high = np.full(len(offset), -1.0), np.full(len(offset), 1.0)
    for _ in range(40 if half_axis.any() else 0):
        s = (low + high) / 2
        point = offset + s[:, None] * half_axis
        rising = (point - np.clip(point, -half, half)) @ half_axis > 0
        low, high = np.where(rising, low, s), np.where(rising, s, high)
    point = offset + ((low + high) / 2)[:, None] * half_axis
    distance: Float64 = np.linalg.norm(point - np.clip(point, -half, half), axis=1)
    return distance


def _boxes_meet(placed: Placed, centers: Float64, half: float) -> Bool:
    """Separating axis test of cubes against an oriented box (Gottschalk et al., OBBTree, SIGGRAPH 1996)."""
    R = placed.T_base_shape[:3, :3]
    extents = placed.shape.half_extents
    crosses = np.cross(np.eye(3)[:, None, :], R.T[None, :, :]).reshape(9, 3)
    axes = np.concatenate([np.eye(3), R.T, crosses[np.linalg.norm(crosses, axis=1) > 1e-9]])
    reach = half * np.abs(axes).sum(axis=1) + np.abs(axes @ R) @ extents
    apart = np.abs((centers - placed.T_base_shape[:3, 3]) @ axes.T) > reach
    meets: Bool = ~apart.any(axis=1)
    return meets
