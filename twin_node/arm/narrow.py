"""Exact distances between capsules and spheres or boxes, for many pairs at once, in closed form.

All distances are between surfaces, in metres, negative where the shapes overlap.
"""

from __future__ import annotations

import numpy as np

from twin_node.geometry import cross
from twin_node.scene import Bool, Float64

_TINY = 1e-30
"""m^2, m: keeps divisions finite for capsules of no length and points that coincide."""
_PAIRS_AT_ONCE = 1000
"""Pairs of capsules and boxes looked at in one go: arrays of 0.2 MB stay in the cache, which halves the time."""


def axis_distances(ends: Float64, centers: Float64) -> Float64:
    """Distances [S, n] of every centre [n, 3] to every segment [S, 2, 3], m."""
    start, axis = ends[:, 0], ends[:, 1] - ends[:, 0]
    length_sq = np.einsum("si,si->s", axis, axis)
    columns = np.ascontiguousarray(centers.T)  # einsum stays on this thread; a product would wake BLAS's pool
    along = np.einsum("si,in->sn", axis, columns) - np.einsum("si,si->s", axis, start)[:, None]
    offset_sq = np.einsum("ni,ni->n", centers, centers) - 2 * np.einsum("si,in->sn", start, columns)
    offset_sq += np.einsum("si,si->s", start, start)[:, None]
    t = along / np.maximum(length_sq, _TINY)[:, None]
    np.clip(t, 0.0, 1.0, out=t)
    offset_sq += t * (t * length_sq[:, None] - 2 * along)
    np.maximum(offset_sq, 0.0, out=offset_sq)
    distances: Float64 = np.sqrt(offset_sq, out=offset_sq)
    return distances


def segment_distances(first: Float64, second: Float64) -> Float64:
    """Distances [...] between segments [..., 2, 3] and segments [..., 2, 3], m.

    Ericson, Real-Time Collision Detection (2005), section 5.1.9; with cross products in place of differences of dot
    products, which cancel where segments are nearly parallel.
    """
    u, v = first[..., 1, :] - first[..., 0, :], second[..., 1, :] - second[..., 0, :]
    offset = first[..., 0, :] - second[..., 0, :]
    uu, vv, uv = (u * u).sum(-1) + _TINY, (v * v).sum(-1) + _TINY, (u * v).sum(-1)
    u_offset, v_offset = (u * offset).sum(-1), (v * offset).sum(-1)
    normal = cross(u, v)
    determinant = (normal * normal).sum(-1)
    parallel = determinant <= 1e-24 * uu * vv
    s = np.where(parallel, 0.0, (cross(v, offset) * normal).sum(-1) / np.where(parallel, 1.0, determinant))
    t = (uv * np.clip(s, 0.0, 1.0) + v_offset) / vv
    s = np.where((t < 0) | (t > 1) | parallel, (uv * np.clip(t, 0.0, 1.0) - u_offset) / uu, s)
    t, s = np.clip(t, 0.0, 1.0), np.clip(s, 0.0, 1.0)
    distances: Float64 = np.linalg.norm(offset + s[..., None] * u - t[..., None] * v, axis=-1)
    return distances


def sphere_distances(ends: Float64, radii: Float64, centers: Float64, sphere_radii: Float64) -> Float64:
    """Distances [n] of pairs: capsules with ends [n, 2, 3] and radii [n], spheres with centres [n, 3] and radii [n]."""
    start, axis = ends[:, 0], ends[:, 1] - ends[:, 0]
    along = np.einsum("ni,ni->n", centers - start, axis) / np.maximum(np.einsum("ni,ni->n", axis, axis), _TINY)
    points = start + np.clip(along, 0.0, 1.0)[:, None] * axis
    distances: Float64 = np.linalg.norm(points - centers, axis=1) - radii - sphere_radii
    return distances


def box_distances(ends: Float64, radii: Float64, centers: Float64, rotations: Float64, half: Float64) -> Float64:
    """Distances [n] of pairs: capsules with ends [n, 2, 3] and radii [n], boxes with centres, rotations, half extents.

    Along a segment the squared distance to a box is convex and piecewise quadratic; its derivative is linear between
    the points where the segment crosses the planes of the faces, so the minimum is found exactly. Where the axis enters
    the box the depth is that of the middle of its way through: right in sign, and never more than the true depth.
    """
    parts = [slice(first, first + _PAIRS_AT_ONCE) for first in range(0, len(ends), _PAIRS_AT_ONCE)]
    found = [_box_distances(*(array[part] for array in (ends, radii, centers, rotations, half))) for part in parts]
    return np.concatenate(found) if found else np.zeros(0)


def _box_distances(ends: Float64, radii: Float64, centers: Float64, rotations: Float64, half: Float64) -> Float64:
    local = (ends - centers[:, None]) @ rotations
    start, stop, half = (np.ascontiguousarray(array.T) for array in (local[:, 0], local[:, 1], half))
    axis = stop - start
    excess = np.abs(start + _nearest_parameter(start, axis, half) * axis) - half
    outside = np.sqrt((np.maximum(excess, 0.0) ** 2).sum(0))
    distances: Float64 = np.where(outside > 0, outside, excess.max(0)) - radii
    return distances


def point_in_box(ends: Float64, center: Float64, rotation: Float64, half: Float64) -> Float64:
    """Point [3] of a segment [2, 3] that lies nearest to a box, or deep inside it, m."""
    local = ((ends - center) @ rotation)[..., None]
    share = _nearest_parameter(local[0], local[1] - local[0], half[:, None])[0]
    point: Float64 = ends[0] + share * (ends[1] - ends[0])
    return point


def _nearest_parameter(start: Float64, axis: Float64, half: Float64) -> Float64:
    """Where [n] along segments (0 to 1, in the box's frame) the distance to the box is least; the middle of a tie.

    Columns are pairs: start, axis and half extents [3, n].
    """
    steep = np.where(np.abs(axis) > 1e-12, axis, 1e-12)
    ends = np.stack([np.zeros_like(start[0]), np.ones_like(start[0])])
    crossings = np.concatenate([(half - start) / steep, (-half - start) / steep])
    knots = np.concatenate([ends, np.clip(crossings, 0.0, 1.0, out=crossings)])
    points = start + knots[:, None] * axis
    points -= np.clip(points, -half, half)
    slope = points[:, 0] * axis[0] + points[:, 1] * axis[1] + points[:, 2] * axis[2]
    return (_zero(knots, slope, slope < 0) + _zero(knots, slope, slope <= 0)) / 2


def _zero(knots: Float64, slope: Float64, before: Bool) -> Float64:
    """Place [n] where rising slopes [k, n] at knots [k, n] reach zero, which is after the knots `before` [k, n].

    The first two knots are 0 and 1: where neither is before, it is 0, where both are, it is 1.
    """
    columns = np.arange(knots.shape[1])
    last = np.where(before, knots, -1.0).argmax(axis=0)
    first = np.where(before, 2.0, knots).argmin(axis=0)
    low, high = slope[last, columns], slope[first, columns]
    start, stop = knots[last, columns], knots[first, columns]
    share = np.clip(-low / np.maximum(high - low, _TINY), 0.0, 1.0)
    found: Float64 = np.where(before[1], 1.0, start + share * (stop - start))
    return found
