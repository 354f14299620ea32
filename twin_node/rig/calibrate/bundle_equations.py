"""Normal equations of a bundle from which what single stamps are off by has been eliminated.

Each image has a delay of its own that meets the board's course, the camera's pose and clock, the lens and the corners,
all in the one direction in which the board moves: a step of the Schur complement of one unknown per image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.normal_equations import NOWHERE, NormalEquations
from twin_node.scene import Float64


@dataclass(frozen=True)
class Delays:
    """What V images of one camera tell of when they were taken, beside all else that may explain them."""

    by_image: Float64
    """[V, n] products of what a delay changes with all that the images' slopes has, the residuals last."""
    by_board: Float64
    """[V, n] the same with the board's shape, [V, 0] where that is fixed."""
    told: Float64
    """[V] inverse variance of a delay, all else being known, 1/s^2."""

    def products(self, others: Float64) -> Float64:
        """[V, n, m] by how much less `by_image` and others [V, m] have in common once delays are free."""
        return self.by_image[:, :, None] * (others / self.told[:, None])[:, None]


@dataclass(frozen=True)
class Late:
    """How delays of V images of one camera follow from all other changes."""

    views: NDArray[np.int64]
    """[V] their numbers."""
    inner: NDArray[np.int64]
    """[V, 24] columns of the course's control poses that their boards' poses are made of."""
    by_inner: Float64
    """[V, 24] products of what a delay changes with what these do."""
    outer: NDArray[np.int64]
    """[n] columns of the camera's pose, clock, lens and readout, as in `Layout`; `NOWHERE` for what is fixed."""
    by_outer: Float64
    """[V, n]."""
    board: NDArray[np.int64]
    """Columns of the board's shape; none where it is fixed."""
    delays: Delays

    def changes(self, inner: Float64, outer: Float64) -> Float64:
        """[V] s, for changes of the course and of what the layout holds."""
        known = self.outer != NOWHERE
        explained = (self.by_inner * inner[self.inner]).sum(1) + self.by_outer[:, known] @ outer[self.outer[known]]
        explained += self.delays.by_board @ outer[self.board]
        return np.asarray((self.delays.by_image[:, -1] - explained) / self.delays.told)


@dataclass(frozen=True)
class Change:
    """A step of the solver."""

    inner: Float64
    """[6 K] of the course."""
    outer: Float64
    """[n] of what the layout holds."""
    delays: Float64
    """[V] s."""


@dataclass(frozen=True)
class BundleEquations:
    """Normal equations from which delays have been eliminated."""

    normal: NormalEquations
    late: tuple[Late, ...]
    """Of every camera whose delays are free."""
    images: int
    """Of all cameras."""

    def delay_variances(self) -> Float64:
        """[V] variance of each delay, s^2, all else being free too; 0 where they are fixed."""
        out = np.zeros(self.images)
        if not self.late:
            return out
        by_outer = np.zeros((sum(len(late.views) for late in self.late), self.normal.outer))
        rows = np.split(by_outer, np.cumsum([len(late.views) for late in self.late])[:-1])
        for own, late in zip(rows, self.late, strict=True):
            known = late.outer != NOWHERE
            own[:, late.outer[known]] = late.by_outer[:, known]
            own[:, late.board] = late.delays.by_board
        inner, by_inner = (
            np.concatenate([getattr(late, name) for late in self.late]) for name in ("inner", "by_inner")
        )
        told = np.concatenate([late.delays.told for late in self.late])
        others = self.normal.variances(inner, by_inner, by_outer)
        out[np.concatenate([late.views for late in self.late])] = (1 + others / told) / told
        return out

    def promise(self, change: Change) -> float:
        """By how much a solution lowers half the sum of squares, were everything straight."""
        inner, outer = self.normal.slopes
        return float(inner @ change.inner + outer @ change.outer) / 2

    def solution(self, damping: float) -> Change:
        """The change that the residuals call for, the diagonal raised by a share."""
        inner, outer = self.normal.solution(damping)
        delays = np.zeros(self.images)
        for late in self.late:
            delays[late.views] = late.changes(inner, outer)
        return Change(inner, outer, delays)
