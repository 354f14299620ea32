"""Who moves with whom: averages over the nodes about each node."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Float64

NEAR_SCALE = 0.15
"""Standard deviation of the nearer average, m: a hand and its forearm."""
BODY_SCALE = 0.8
"""Standard deviation of the wider average, m: most of a person."""
_NEAREST = 8
"""Nodes that the nearer average is taken over."""
CELL = 0.25
"""Edge of the cells that stand for the nodes in them in the wider average, m: a third of its scale."""


class _Cells(NamedTuple):
    """Nodes by cells."""

    order: NDArray[np.int64]
    """[M] rows of the nodes, cell by cell."""
    starts: NDArray[np.int64]
    """[C] where each cell's nodes begin."""


class Neighbours:
    """Gaussian averages over the nodes about each of M nodes, the node itself included."""

    def __init__(self, positions: Float64, near: Closest | None = None) -> None:
        """`positions` [M, 3] m; `near`: what `closest` says of them, if that is known."""
        from scipy.spatial.distance import cdist  # loads slowly, and who only reads parameters never asks

        count = len(positions)
        distances, self._nearest = closest(positions) if near is None else near
        self._near_weights = _weights(distances**2, NEAR_SCALE)
        self._by_cell, self._starts = _cells_of(np.floor(positions / CELL))
        self._sizes = np.diff(self._starts, append=count).astype(np.float64)
        squared = cdist(positions, self._cell_means(positions), "sqeuclidean")
        self._body_weights = _weights(squared, BODY_SCALE, self._sizes)

    def near(self, values: Float64) -> Float64:
        """Averages [M, F] of values [M, F] over a limb's width."""
        averages: Float64 = np.einsum("mk,mkf->mf", self._near_weights, values[self._nearest])
        return averages

    def body(self, values: Float64) -> Float64:
        """Averages [M, F] of values [M, F] over a person's reach."""
        averages: Float64 = self._body_weights @ self._cell_means(values)
        return averages

    def _cell_means(self, values: Float64) -> Float64:
        """[C, F] means over the nodes of each cell."""
        means: Float64 = np.add.reduceat(values[self._by_cell], self._starts) / self._sizes[:, None]
        return means


class Closest(NamedTuple):
    """The k nodes that are nearest to each of M nodes: itself, and others."""

    distances: Float64
    """[M, k] m."""
    rows: NDArray[np.int64]
    """[M, k]."""


def closest(positions: Float64) -> Closest:
    """Of nodes at `positions` [M, 3] (m), those that the nearer average is taken over."""
    from scipy.spatial import cKDTree  # loads slowly, and who only reads parameters never asks

    count = len(positions)
    if count < 2:
        return Closest(np.zeros((count, 1)), np.zeros((count, 1), np.int64))
    return Closest(*cKDTree(positions).query(positions, k=min(_NEAREST, count)))


def _cells_of(places: Float64) -> _Cells:
    """Which nodes lie in the same cell, by the cells' `places` [M, 3] on their lattice."""
    order = np.lexsort(places.T[::-1])
    is_new = np.ones(len(places), np.bool_)
    is_new[1:] = (np.diff(places[order], axis=0) != 0).any(axis=1)
    return _Cells(order, np.flatnonzero(is_new))


def _weights(squared: Float64, scale: float, counts: Float64 | float = 1.0) -> Float64:
    weights = counts * np.exp(squared * (-0.5 / scale**2))
    normalised: Float64 = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    return normalised
