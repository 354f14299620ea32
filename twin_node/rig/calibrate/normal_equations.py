"""Normal equations with many inner unknowns, each met by few neighbours, and few outer ones that meet all.

Eliminating the inner unknowns leaves a small dense system (the Schur complement: Triggs et al., Bundle Adjustment: A
Modern Synthesis, 1999, section 6.1). SciPy factors what is banded; its least-squares solvers do not know of the shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.sparse import csc_array

from twin_node.scene import Float64

NOWHERE = -1
"""Outer column of what is not an unknown."""

HELD = 1e-6
"""Weight with which unknowns are held that nothing speaks of: a board's course where all images were misread, and its
corners that no image shows."""


LEAST_TOLD = 1e-13
"""Share of an unknown's own weight that is left when all others are free, below which it is rounding."""


class NormalEquations:
    """J^T J and J^T r, summed up block by block."""

    def __init__(self, inner: int, band: int, outer: int) -> None:
        """`inner`: unknowns of which no block holds two more than `band` apart; `outer`: all others."""
        self._A = np.zeros((inner, band + 1))
        self._a = np.zeros(inner)
        # One more outer unknown, at the end, takes what goes nowhere.
        self._B = np.zeros((inner, outer + 1))
        self._C = np.zeros((outer + 1, outer + 1))
        self._c = np.zeros(outer + 1)

    def add_inner(self, columns: NDArray[np.int64], squares: Float64, slopes: Float64) -> None:
        """Blocks [V, n, n] and [V, n] at rising inner columns [V, n]."""
        np.add.at(self._a, columns, slopes)
        lower = columns[:, :, None] - columns[:, None, :]
        kept = lower >= 0
        places = (columns[:, None, :] * self._A.shape[1] + lower)[kept]
        self._A += np.bincount(places, squares[kept], self._A.size).reshape(self._A.shape)

    def add_outer(self, columns: NDArray[np.int64], squares: Float64, slopes: Float64) -> None:
        """A block [m, m] and [m] at outer columns [m], all others than each other."""
        self._c[columns] += slopes
        self._C[columns[:, None], columns] += squares

    def add_between(self, rows: NDArray[np.int64], columns: NDArray[np.int64], products: Float64) -> None:
        """A block [m, n] between outer unknowns [m] and others [n]."""
        self._C[rows[:, None], columns] += products
        self._C[columns[:, None], rows] += products.T

    def add_mixed(self, inner: NDArray[np.int64], outer: NDArray[np.int64], products: Float64) -> None:
        """Blocks [V, n, m] at inner columns [V, n] and outer columns [m], these all others than each other."""
        adder = csc_array((np.ones(inner.size), inner.ravel(), np.arange(inner.size + 1)), (len(self._B), inner.size))
        self._B[:, outer] += adder @ products.reshape(inner.size, -1)

    @property
    def slopes(self) -> tuple[Float64, Float64]:
        """J^T r of the inner and the outer unknowns."""
        return self._a, self._c[:-1]

    def solution(self, damping: float) -> tuple[Float64, Float64]:
        """Changes of the inner and the outer unknowns that the slopes call for, the diagonal raised by a share."""
        A, B, C = self._A.T.copy(), self._B[:, :-1], self._C[:-1, :-1].copy()
        A[0] = A[0] * (1 + damping) + HELD
        own = np.diag(C)
        C[np.diag_indices_from(C)] = np.where(own > 0, own * (1 + damping), HELD)
        factor = (cholesky_banded(A, lower=True), True)
        reach = cho_solve_banded(factor, np.concatenate([B, self._a[:, None]], axis=1))
        schur = C - B.T @ reach[:, :-1]
        outer = np.asarray(cho_solve(cho_factor(schur), self._c[:-1] - B.T @ reach[:, -1]))
        return np.asarray(reach[:, -1] - reach[:, :-1] @ outer), outer

    @property
    def outer(self) -> int:
        """Count of outer unknowns."""
        return len(self._c) - 1

    def variances(self, columns: NDArray[np.int64], by_inner: Float64, by_outer: Float64) -> Float64:
        """[V] of sums of inner unknowns at `columns` [V, n] times `by_inner` [V, n] and all outer ones [V, outer].

        The columns of a sum are no further apart than those of a block.
        """
        A, B = self._A.T.copy(), self._B[:, :-1]
        A[0] += HELD
        reach = cho_solve_banded((cholesky_banded(A, lower=True), True), B)
        rest = by_outer - (by_inner[:, None] @ reach[columns])[:, 0]
        inner = (by_inner[:, None] @ self.inner_covariances(columns) @ by_inner[..., None])[:, 0, 0]
        return np.asarray(inner + ((rest @ self.outer_covariance()) * rest).sum(1))

    def inner_covariances(self, columns: NDArray[np.int64]) -> Float64:
        """[V, n, n] of inner unknowns at `columns` [V, n], no further apart than those of a block, all outer known."""
        A = self._A.T.copy()
        A[0] += HELD
        pairs = np.stack(np.broadcast_arrays(columns[:, :, None], columns[:, None]))
        return np.asarray(inverse_band(A)[np.ptp(pairs, axis=0), pairs.min(axis=0)])

    def outer_covariance(self) -> Float64:
        """[outer, outer] inverse of the Schur complement; what rounding leaves of an unknown is open, not certain."""
        A, B, C = self._A.T.copy(), self._B[:, :-1], self._C[:-1, :-1]
        A[0] += HELD
        reach = cho_solve_banded((cholesky_banded(A, lower=True), True), B)
        scale = np.sqrt(np.maximum(np.diag(C), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh((C - B.T @ reach) / scale[:, None] / scale)
        spread = vectors / np.sqrt(np.maximum(values, LEAST_TOLD)) / scale[:, None]
        return np.asarray(spread @ spread.T)


def inverse_band(A: Float64) -> Float64:
    """[band + 1, N] the inverse of a symmetric positive definite matrix where that is not 0; both lower and banded.

    In blocks as wide as the band, of which only neighbours meet: the recursion of Takahashi, Fagan and Chin (1973).
    """
    width, count = len(A), A.shape[1]
    blocks = -(-count // width)
    padded = np.zeros((width, blocks * width))
    padded[:, :count], padded[0, count:] = A, 1.0
    lag = np.arange(2 * width)[:, None] - np.arange(width)
    columns = width * np.arange(blocks)[:, None, None] + np.arange(width)
    lower = np.where((lag >= 0) & (lag < width), padded[np.clip(lag, 0, width - 1), columns], 0.0)
    own, below = lower[:, :width], lower[:, width:]
    own = own + np.tril(own, -1).swapaxes(1, 2)
    gains = np.zeros_like(below)  # what a block's unknowns make of the next one's, negated
    for i in range(1, blocks):
        gains[i - 1] = np.linalg.solve(own[i - 1], below[i - 1].T).T
        own[i] -= gains[i - 1] @ below[i - 1].T
    inverse = np.concatenate([np.linalg.inv(own), np.zeros_like(own)], axis=1)
    for i in range(blocks - 2, -1, -1):
        inverse[i, width:] = -inverse[i + 1, :width] @ gains[i]
        inverse[i, :width] -= gains[i].T @ inverse[i, width:]
    lag, column = np.indices((width, width))
    return np.asarray(inverse[:, lag + column, column].swapaxes(0, 1).reshape(width, -1)[:, :count])
