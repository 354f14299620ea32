"""Exact distances between capsules and spheres or boxes, for many pairs at once, in closed form.

All distances are between surfaces, in metres, negative where the shapes overlap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Float64

_TINY = 1e-30
"""m^2, m: keeps divisions finite for capsules of no length and points that coincide."""


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
    normal = _cross(u, v)
    determinant = (normal * normal).sum(-1)
    parallel = determinant <= 1e-24 * uu * vv
    s = np.where(parallel, 0.0, (_cross(v, offset) * normal).sum(-1) / np.where(parallel, 1.0, determinant))
    t = (uv * np.clip(s, 0.0, 1.0) + v_offset) / vv
    s = np.where((t < 0) | (t > 1) | parallel, (uv * np.clip(t, 0.0, 1.0) - u_offset) / uu, s)
    t, s = np.clip(t, 0.0, 1.0), np.clip(s, 0.0, 1.0)
    distances: Float64 = np.linalg.norm(offset + s[..., None] * u - t[..., None] * v, axis=-1)
    return distances


def _cross(a: Float64, b: Float64) -> Float64:
    """Cross products [..., 3]: a third of the time that `np.cross` takes."""
    after, before = np.array([1, 2, 0]), np.array([2, 0, 1])
    product: Float64 = a[..., after] * b[..., before] - a[..., before] * b[..., after]
    return product


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
    local = (ends - centers[:, None]) @ rotations
    start, axis = local[:, 0], local[:, 1] - local[:, 0]
    points = start + _nearest_parameter(start, axis, half)[:, None] * axis
    excess = np.abs(points) - half
    outside = np.linalg.norm(np.maximum(excess, 0.0), axis=1)
    distances: Float64 = np.where(outside > 0, outside, excess.max(1)) - radii
    return distances


def point_in_box(ends: Float64, center: Float64, rotation: Float64, half: Float64) -> Float64:
    """Point [3] of a segment [2, 3] that lies nearest to a box, or deep inside it, m."""
    local = (ends - center) @ rotation
    share = _nearest_parameter(local[:1], local[1:] - local[:1], half[None])[0]
    point: Float64 = ends[0] + share * (ends[1] - ends[0])
    return point


def _nearest_parameter(start: Float64, axis: Float64, half: Float64) -> Float64:
    """Where [n] along segments (0 to 1, in the box's frame) the distance to the box is least; the middle of a tie."""
    steep = np.where(np.abs(axis) > 1e-12, axis, 1e-12)
    crossings = np.concatenate([(half - start) / steep, (-half - start) / steep], axis=1)
    knots = np.concatenate([np.clip(crossings, 0.0, 1.0), np.zeros((len(start), 1)), np.ones((len(start), 1))], axis=1)
    knots.sort(axis=1)
    points = start[:, None] + knots[..., None] * axis[:, None]
    excess = np.sign(points) * np.maximum(np.abs(points) - half[:, None], 0.0)
    slope = np.einsum("nki,ni->nk", excess, axis)
    return (_zero(knots, slope, -1) + _zero(knots, slope, 1)) / 2


def _zero(knots: Float64, slope: Float64, side: int) -> Float64:
    """First (`side` -1) or last (+1) place [n] where rising slopes [n, k], given at knots [n, k], are zero."""
    rows = np.arange(len(knots))
    if side < 0:
        after = np.argmax(slope >= 0, axis=1)
        after = np.where((slope >= 0).any(1), after, slope.shape[1] - 1)
        before = np.maximum(after - 1, 0)
    else:
        before = slope.shape[1] - 1 - np.argmax(slope[:, ::-1] <= 0, axis=1)
        before = np.where((slope <= 0).any(1), before, 0)
        after = np.minimum(before + 1, slope.shape[1] - 1)
    low, high = slope[rows, before], slope[rows, after]
    rise = high - low
    share = np.where(rise > _TINY, -low / np.where(rise > _TINY, rise, 1.0), 0.0 if side > 0 else 1.0)
    found: NDArray[np.float64] = knots[rows, before] + np.clip(share, 0.0, 1.0) * (
        knots[rows, after] - knots[rows, before]
    )
    return found
