"""Normal equations with many inner unknowns, each met by few neighbours, and few outer ones that meet all.

Eliminating the inner unknowns leaves a small dense system (the Schur complement: Triggs et al., Bundle Adjustment: A
Modern Synthesis, 1999, section 6.1). SciPy factors what is banded; its least-squares solvers do not know of the shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded

from twin_node.scene import Float64

NOWHERE = -1
"""Column of what is not an unknown."""

HELD = 1e-6
"""Weight with which inner unknowns are held that nothing speaks of: a board's course where all images were misread."""


class NormalEquations:
    """J^T J and J^T r, summed up block by block."""

    def __init__(self, inner: int, band: int, outer: int) -> None:
        """`inner`: unknowns of which no block holds two more than `band` apart; `outer`: all others."""
        self._band = band
        # One more of each, at the end, takes what goes nowhere.
        self._A = np.zeros((inner + 1, band + 1))
        self._B = np.zeros((inner + 1, outer + 1))
        self._C = np.zeros((outer + 1, outer + 1))
        self._a = np.zeros(inner + 1)
        self._c = np.zeros(outer + 1)

    def add_inner(self, columns: NDArray[np.int64], squares: Float64, slopes: Float64) -> None:
        """Blocks [V, n, n] and [V, n] at rising inner columns [V, n]."""
        np.add.at(self._a, columns, slopes)
        lower = columns[:, :, None] - columns[:, None, :]
        rows = np.broadcast_to(columns[:, None, :], lower.shape)
        kept = (lower >= 0) & (columns[:, None, :] >= 0)
        np.add.at(self._A, (rows[kept], lower[kept]), squares[kept])

    def add_outer(self, columns: NDArray[np.int64], squares: Float64, slopes: Float64) -> None:
        """A block [m, m] and [m] at outer columns [m]."""
        np.add.at(self._c, columns, slopes)
        np.add.at(self._C, (columns[:, None], columns), squares)

    def add_between(self, rows: NDArray[np.int64], columns: NDArray[np.int64], products: Float64) -> None:
        """A block [m, n] between outer unknowns [m] and others [n]."""
        np.add.at(self._C, (rows[:, None], columns), products)
        np.add.at(self._C, (columns[:, None], rows), products.T)

    def add_mixed(self, inner: NDArray[np.int64], outer: NDArray[np.int64], products: Float64) -> None:
        """Blocks [V, n, m] at inner columns [V, n] and outer columns [m]."""
        np.add.at(self._B, (inner[:, :, None], outer), products)

    @property
    def slopes(self) -> tuple[Float64, Float64]:
        """J^T r of the inner and the outer unknowns."""
        return self._a[:-1], self._c[:-1]

    def solution(self, damping: float) -> tuple[Float64, Float64]:
        """Changes of the inner and the outer unknowns that the slopes call for, the diagonal raised by a share."""
        A, B, C = self._A[:-1].T.copy(), self._B[:-1, :-1], self._C[:-1, :-1].copy()
        A[0] = A[0] * (1 + damping) + HELD
        C[np.diag_indices_from(C)] *= 1 + damping
        factor = (cholesky_banded(A, lower=True), True)
        reach = cho_solve_banded(factor, np.concatenate([B, self._a[:-1, None]], axis=1))
        schur = C - B.T @ reach[:, :-1]
        outer = np.asarray(cho_solve(cho_factor(schur), self._c[:-1] - B.T @ reach[:, -1]))
        return np.asarray(reach[:, -1] - reach[:, :-1] @ outer), outer

    def outer_covariance(self) -> Float64:
        """[outer, outer] inverse of the Schur complement."""
        A, B, C = self._A[:-1].T.copy(), self._B[:-1, :-1], self._C[:-1, :-1]
        A[0] += HELD
        reach = cho_solve_banded((cholesky_banded(A, lower=True), True), B)
        return np.asarray(np.linalg.pinv(C - B.T @ reach, hermitian=True))
