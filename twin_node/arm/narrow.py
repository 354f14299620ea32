"""Exact distances between capsules and spheres or boxes, for many pairs at once, in closed form.

All distances are between surfaces, in metres, negative where the shapes overlap.
"""

from __future__ import annotations

import numpy as np

from twin_node.geometry import cross
from twin_node.scene import Bool, Float64

_TINY = 1e-30
"""m^2, m: keeps divisions finite for capsules of no length and points that coincide."""
_PAIRS_AT_ONCE = 8000
"""Pairs of capsules and boxes looked at in one go: arrays of 0.2 MB stay in the cache."""
_NEWTON_STEPS = 2
"""Of the demo's pairs 0.3 % are left over, all but a few of them because they touch."""
_FLAT = 1e-11
"""Slope of half the squared distance along a segment, by that distance, m: by so little the distance may be off."""
_TOUCH_M = 1e-8
"""What is nearer to a box may be inside it, m."""


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
    """Distances [..., n] of capsules (ends [..., n, 2, 3], radii [n]) to spheres (centres [n, 3], radii [n])."""
    start, axis = ends[..., 0, :], ends[..., 1, :] - ends[..., 0, :]
    offset = start - centers
    share = np.einsum("...i,...i->...", offset, axis)
    share /= -np.maximum(np.einsum("...i,...i->...", axis, axis), _TINY)
    axis *= _into_unit(share)[..., None]
    offset += axis
    distances: Float64 = np.sqrt(np.einsum("...i,...i->...", offset, offset))
    distances -= radii
    distances -= sphere_radii
    return distances


def box_distances(ends: Float64, radii: Float64, centers: Float64, rotations: Float64 | None, half: Float64) -> Float64:
    """Distances [..., n] of capsules (ends [..., n, 2, 3], radii [n]) to boxes (centres, rotations, half extents [n]).

    Without `rotations` no box is turned. Along a segment the squared distance to a box is convex and piecewise
    quadratic: Newton's steps find its minimum exactly once they are on its piece. Pairs that they leave over, and those
    whose axis touches the box, are measured knot by knot. Where the axis enters the box the depth is that of the middle
    of its way through: right in sign, and never more than the true depth.
    """
    distances = np.empty(ends.shape[:-2])
    width = max(_PAIRS_AT_ONCE * len(radii) // max(distances.size, 1), 1)
    for first in range(0, len(radii), width):
        part = slice(first, first + width)
        turns = None if rotations is None else rotations[part]
        start, axis = _in_boxes(ends[..., part, :, :], centers[part], turns)
        distances[..., part] = _box_distances(start, axis, half[part].T) - radii[part]
    return distances


def _in_boxes(ends: Float64, centers: Float64, rotations: Float64 | None) -> tuple[Float64, Float64]:
    """Starts and axes [3, ..., n] of segments [..., n, 2, 3] in the frames of boxes, as columns."""
    local = ends - centers[:, None]
    if rotations is not None:
        local = local @ rotations
    start, stop = np.ascontiguousarray(np.moveaxis(local, (-2, -1), (0, 1)))
    return start, stop - start


def _box_distances(start: Float64, axis: Float64, half: Float64) -> Float64:
    """Distances [..., n] of segments (starts and axes [3, ..., n], in the boxes' frames) to boxes (half [3, n]), m."""
    half = np.ascontiguousarray(half).reshape(3, *(1,) * (start.ndim - 2), -1)
    squares = axis * axis
    share = _dot(start, axis)
    share /= -np.maximum(squares.sum(0), _TINY)  # where it is nearest to the box's centre
    _into_unit(share)
    for _ in range(_NEWTON_STEPS):
        beyond = _beyond(start, axis, share, half)
        curvature = _dot(squares, beyond != 0)
        share -= _dot(beyond, axis) / np.maximum(curvature, _TINY, out=curvature)
        _into_unit(share)
    beyond = _beyond(start, axis, share, half)
    slope, outside = _dot(beyond, axis), np.sqrt(_dot(beyond, beyond))
    left = np.abs(slope) > _FLAT * outside
    left &= (share > 0) | (slope < 0)
    left &= (share < 1) | (slope > 0)
    left |= outside < _TOUCH_M
    if left.any():
        shape = start.shape
        outside[left] = _by_knots(start[:, left], axis[:, left], np.broadcast_to(half, shape)[:, left])
    return outside


def _beyond(start: Float64, axis: Float64, share: Float64, half: Float64) -> Float64:
    """What leads [3, ..., n] from boxes about the origin to points at shares [..., n] of segments, m."""
    points = share * axis
    points += start
    nearest = np.maximum(points, -half)
    points -= np.minimum(nearest, half, out=nearest)
    return points


def _dot(first: Float64, second: Float64 | Bool) -> Float64:
    """Products [..., n] of columns [3, ..., n]."""
    product: Float64 = np.einsum("i...,i...->...", first, second)
    return product


def _into_unit(shares: Float64) -> Float64:
    """Brings shares to 0 to 1, in place."""
    return np.minimum(np.maximum(shares, 0.0, out=shares), 1.0, out=shares)


def _by_knots(start: Float64, axis: Float64, half: Float64) -> Float64:
    """Distances [n] of segments (starts and axes [3, n]) to boxes (half extents [3, n]), m; negative inside.

    The derivative of the squared distance is linear between the points where the segment crosses the planes of the
    faces, so the minimum is found exactly.
    """
    excess = np.abs(start + _nearest_parameter(start, axis, half) * axis) - half
    outside = np.sqrt((np.maximum(excess, 0.0) ** 2).sum(0))
    distances: Float64 = np.where(outside > 0, outside, excess.max(0))
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
