"""Which of some points are nearest to others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.kernels import Kernels, kernels
from twin_node.forecast.part_requests import NearestRequest
from twin_node.native_library import addresses_of
from twin_node.scene import Float64


class Nearest(NamedTuple):
    """The k of m points that are nearest to each of n others, the nearest first."""

    distances: Float64
    """[..., n, k] m; infinite where there are no more."""
    rows: NDArray[np.int64]
    """[..., n, k] among the m; m where there are no more."""


def nearest(points: Float64, among: Float64, count: int = 1, within: float = np.inf) -> Nearest:
    """The `count` of the points `among` [..., m, 3] that are nearest to each of `points` [n, 3], nearer than `within`.

    All in metres. Compiled: to look at all of some hundred takes less time than to build a tree; `nearest_reference`
    for more, and where that cannot be.
    """
    compiled, pairs = kernels(), len(points) * among.shape[-2]
    if compiled is not None and pairs <= _MOST_PAIRS:
        return _nearest_by(compiled, points, among, count, within)
    if count > 1 or among.ndim > 2:
        return nearest_reference(points, among, count, within)
    distances, rows = nearest_one(points, among, within)
    return Nearest(distances[:, None], rows[:, None])


def _nearest_by(compiled: Kernels, points: Float64, among: Float64, count: int, within: float) -> Nearest:
    groups, shape = among.shape[:-2], (*among.shape[:-2], len(points), count)
    found = Nearest(np.empty(shape), np.empty(shape, np.int64))
    given = (np.ascontiguousarray(points, np.float64), np.ascontiguousarray(among, np.float64))
    sizes = (int(np.prod(groups)), len(points), among.shape[-2], count, within)
    compiled.run(NearestRequest(*sizes, *addresses_of(*given, *found)))
    return found


def nearest_reference(points: Float64, among: Float64, count: int = 1, within: float = np.inf) -> Nearest:
    """What `nearest` does, by a tree for each group."""
    from scipy.spatial import cKDTree  # loads slowly, and kernels do without

    if among.ndim > 2:
        groups = [nearest_reference(points, group, count, within) for group in among]
        return Nearest(np.stack([group.distances for group in groups]), np.stack([group.rows for group in groups]))
    known = np.flatnonzero(np.isfinite(among).all(axis=1))
    distances, rows = cKDTree(among[known]).query(points, np.arange(1, count + 1), distance_upper_bound=within)
    return Nearest(distances, np.append(known, len(among))[rows])


class NearestOne(NamedTuple):
    """Which of m points is nearest to each of n others."""

    distances: Float64
    """[n] m; infinite where there is none."""
    rows: NDArray[np.int64]
    """[n] among the m; m where there is none."""


def nearest_one(points: Float64, among: Float64, within: float) -> NearestOne:
    """Which of the points `among` [m, 3] is nearest to each of `points` [n, 3], nearer than `within`; in metres.

    Where some point has two that are as near, a tree says which is taken: so it is the same one whoever looks for it.
    """
    compiled = kernels()
    if compiled is not None and len(points) * len(among) <= _MOST_PAIRS_OF_ONE:
        distances, rows = _nearest_by(compiled, points, among, 2, within)
        if not ((distances[:, 0] == distances[:, 1]) & (rows[:, 1] < len(among))).any():
            return NearestOne(distances[:, 0], rows[:, 0])
    distances, rows = nearest_reference(points, among, 1, within)
    return NearestOne(distances[:, 0], rows[:, 0])


_MOST_PAIRS = 100_000
"""Pairs of points that are looked at; with more of them a tree takes as long or less (measured: 400 points)."""
_MOST_PAIRS_OF_ONE = 400_000
"""The same where one or two are wanted (600 points)."""
