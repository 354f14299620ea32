"""Encloses a triangle mesh in few capsules: made the tables of `ur.py`, and reads other arms' meshes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import distance_to_segment
from twin_node.scene import Float64

_LLOYD_ROUNDS = 6
"""Most rounds of giving pieces to capsules and fitting again; the volume stops falling after two to four."""


_PIECE_SHARE = 0.05
"""Longest edge of a piece as a share of the mesh's extent."""
_END_SHARES = (0.1, 0.15, 0.2, 0.25)
"""Shares of a link's length tried for the housings at its ends."""


_MOST_REMEMBERED = 256
"""Meshes; an arm has a dozen."""


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` of the segment between two ends, in a link's frame."""

    ends: Float64
    """[2, 3] m; equal ends make a sphere."""
    radius: float

    @property
    def volume(self) -> float:
        """Volume, m^3."""
        length = float(np.linalg.norm(self.ends[1] - self.ends[0]))
        return float(np.pi * self.radius**2 * (length + 4 / 3 * self.radius))


_fitted: dict[tuple[bytes, int], tuple[Capsule, ...]] = {}
"""What meshes, by the hash of their triangles and the number of capsules, were found to be enclosed by."""


def fit_capsule(points: NDArray[np.floating], near: Capsule | None = None) -> Capsule:
    """Small capsule that holds all points [N, 3] (m): a local minimum of its volume, started from their main axes.

    `near` starts from that capsule instead. The radius is the largest distance from a point to the segment, so
    enclosure is exact whatever the minimiser does.
    """
    from scipy.optimize import minimize  # loads slowly, and most processes that have an arm never ask

    cloud = _extreme_points(np.asarray(points, dtype=np.float64))
    starts = _main_axes(cloud) if near is None else [near.ends]
    options = {"maxiter": 1500, "xatol": 1e-4, "fatol": 1e-7}
    volume = _VolumeHolding(cloud)
    found = [minimize(volume, start.ravel(), method="Nelder-Mead", options=options) for start in starts]
    return min((_capsule_holding(result.x, cloud) for result in found), key=lambda capsule: capsule.volume)


def fit_capsules(triangles: NDArray[np.floating], count: int) -> tuple[Capsule, ...]:
    """`count` capsules that together hold a mesh's surface, triangles [T, 3, 3] in metres.

    Triangles are split into pieces much smaller than the mesh; each piece lies inside one capsule, and a capsule is
    convex, so the union holds the whole surface. Pieces move between capsules by Lloyd's scheme; the
    smallest total volume met is kept.
    The process remembers what it has fitted: an arm is read by its driver and by who judges it, and takes seconds.
    """
    corners = np.asarray(triangles, dtype=np.float64)
    asked = hashlib.sha256(corners.tobytes()).digest(), count
    if asked not in _fitted:
        if len(_fitted) >= _MOST_REMEMBERED:
            _fitted.clear()
        _fitted[asked] = _fit(corners, count)
    return _fitted[asked]


def _fit(corners: Float64, count: int) -> tuple[Capsule, ...]:
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    pieces = _split(corners, _PIECE_SHARE * extent)
    centers = pieces.mean(1)
    axis = np.linalg.svd(centers - centers.mean(0), full_matrices=False)[2][0]
    along = centers @ axis
    along = (along - along.min()) / max(float(np.ptp(along)), 1e-12)
    fits = [_lloyd(pieces, np.searchsorted(cuts, along)) for cuts in _first_cuts(count)]
    return min(fits, key=_total_volume)


def _first_cuts(count: int) -> list[Float64]:
    """Shares of the length at which the mesh is first cut: evenly, and with short ends (the joints' housings)."""
    cuts = [np.linspace(0, 1, count + 1)[1:-1]]
    if count >= 3:
        cuts += [np.linspace(end, 1 - end, count - 1) for end in _END_SHARES]
    return cuts


def _lloyd(pieces: Float64, owner: NDArray[np.integer]) -> tuple[Capsule, ...]:
    """Fits a capsule to each owner's pieces, gives each piece to the capsule that holds it best, and again."""
    capsules = tuple(fit_capsule(pieces[owner == k].reshape(-1, 3)) for k in np.unique(owner))
    best = capsules
    for _ in range(_LLOYD_ROUNDS):
        owner = np.argmin(np.stack([_outside(pieces, capsule) for capsule in capsules]), axis=0)
        kept = [(capsule, pieces[owner == k].reshape(-1, 3)) for k, capsule in enumerate(capsules)]
        capsules = tuple(fit_capsule(own, near=capsule) for capsule, own in kept if len(own))
        if _total_volume(capsules) >= _total_volume(best):
            break
        best = capsules
    return best


def _main_axes(cloud: Float64) -> list[Float64]:
    """Segments [2, 3] along each main axis of a cloud, half as long as it."""
    center = (cloud.min(0) + cloud.max(0)) / 2
    axes = np.linalg.svd(cloud - cloud.mean(0), full_matrices=False)[2]
    reach = np.abs((cloud - center) @ axes.T).max(0)
    half = axes * reach[:, None] / 2
    return list(np.stack([center - half, center + half], axis=1))


def _capsule_holding(parameters: Float64, cloud: Float64) -> Capsule:
    ends = parameters.reshape(2, 3)
    return Capsule(ends, float(distance_to_segment(cloud, ends).max()))


class _VolumeHolding:
    """Volume, m^3, of the capsule about two ends (6 numbers) that holds a cloud [N, 3].

    Asked some hundred times per fit, so from few products: rounding moves the radius by less than a nanometre, and
    `_capsule_holding` says it exactly in the end.
    """

    def __init__(self, cloud: Float64) -> None:
        self._middle = cloud.mean(0)
        self._cloud = cloud - self._middle
        self._squares = np.einsum("ni,ni->n", self._cloud, self._cloud)

    def __call__(self, parameters: Float64) -> float:
        first = parameters[:3] - self._middle
        axis = parameters[3:] - parameters[:3]
        length_sq = max(float(axis @ axis), 1e-18)
        along = self._cloud @ axis - float(first @ axis)
        share = np.minimum(np.maximum(along / length_sq, 0.0), 1.0)
        squares = self._squares - self._cloud @ (2 * first) + share * (share * length_sq - 2 * along)
        radius = max(float(squares.max()) + float(first @ first), 0.0) ** 0.5
        return float(np.pi * radius**2 * (length_sq**0.5 + 4 / 3 * radius))


def _total_volume(capsules: tuple[Capsule, ...]) -> float:
    return sum(capsule.volume for capsule in capsules)


def _outside(pieces: Float64, capsule: Capsule) -> Float64:
    """How far [P] each piece's farthest corner is outside a capsule, m; negative inside."""
    farthest: Float64 = distance_to_segment(pieces, capsule.ends).max(1)
    return farthest - capsule.radius


def _extreme_points(points: Float64) -> Float64:
    """The convex hull's corners: all that an enclosing convex shape has to hold."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners: Float64 = points[ConvexHull(points).vertices]
    except QhullError:  # flat or too few points: they are all extreme as far as the fit is concerned
        corners = np.unique(points, axis=0)
    return corners


def _split(triangles: Float64, max_edge: float) -> Float64:
    """Triangles [T', 3, 3] of the same surface with no edge longer than `max_edge`, by halving the longest edges."""
    done = []
    rest = triangles
    while len(rest):
        lengths = np.linalg.norm(rest - np.roll(rest, -1, axis=1), axis=2)
        small = lengths.max(1) <= max_edge
        done.append(rest[small])
        rest, lengths = rest[~small], lengths[~small]
        first = lengths.argmax(1)
        rows = np.arange(len(rest))
        a, b, c = rest[rows, first], rest[rows, (first + 1) % 3], rest[rows, (first + 2) % 3]
        middle = (a + b) / 2
        rest = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    return np.concatenate(done)
