"""Boxes about voxels on an octree: as few as asked for, about as little else as possible.

The plain way, step by step; `covering` does all of it in one compiled call.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Bits
from twin_node.scene import Bool, Grid

SMALLEST = 4
"""Voxels along a cell of level 0; each level doubles it."""
HIGHEST_LEVEL = 7
"""A cell of this level is 512 voxels wide: a longer grid has several, which one box holds where the cap asks for it."""
PRICES = np.append(np.geomspace(1.0, 1e6, 40), np.inf)
"""What one more box may cost, in voxels of space that it spares: rising, up to one box at any price."""
LOYALTY = 0.7
"""Space of a box that was there before counts this much less: a cover does not flicker between equally good ones."""


@dataclass(frozen=True)
class Boxes:
    """Tight boxes about the occupied voxels of distinct octree cells, in voxel coordinates."""

    levels: NDArray[np.int64]
    """[c] of the cells."""
    cells: NDArray[np.int64]
    """[c, 3] cell coordinates on their level."""
    lower: NDArray[np.int64]
    """[c, 3] first voxel."""
    upper: NDArray[np.int64]
    """[c, 3] last voxel."""

    def __len__(self) -> int:
        return len(self.levels)

    def rows(self, chosen: NDArray[np.int64] | Bool) -> Boxes:
        """Some of them."""
        return Boxes(self.levels[chosen], self.cells[chosen], self.lower[chosen], self.upper[chosen])

    def joined(self, *others: Boxes) -> Boxes:
        """These and others, one after the other."""
        parts = (self, *others)
        return Boxes(
            np.concatenate([part.levels for part in parts]),
            np.concatenate([part.cells for part in parts]),
            np.concatenate([part.lower for part in parts]),
            np.concatenate([part.upper for part in parts]),
        )

    def places(self, grid: Grid) -> NDArray[np.int64]:
        """[c] number of each cell: level << 21, plus its flat index on the lattice of level 0."""
        lattice = _lattice(grid)
        flat = (self.cells[:, 0] * lattice[1] + self.cells[:, 1]) * lattice[2] + self.cells[:, 2]
        return (self.levels << 21) | (flat & 0x1FFFFF)


def smallest_boxes(grid: Grid, indices: NDArray[np.integer]) -> Boxes:
    """One box per cell of level 0 that holds any of the voxels [n], which come in any order, also twice."""
    voxels = np.stack(np.unravel_index(indices.astype(np.int64), grid.dims), axis=1)
    return _by_cell(0, voxels // SMALLEST, voxels, voxels).boxes


def mostly_full(grid: Grid, mask: Bits, share: float) -> Boxes:
    """The whole cells of level 0 of which a mask fills some, and at least a share of what lies in the grid."""
    counts = voxels_per_cell(grid, mask)
    cells = np.stack(np.unravel_index(np.flatnonzero(counts), _lattice(grid)), axis=1)
    lower, upper = cells * SMALLEST, np.minimum((cells + 1) * SMALLEST, np.array(grid.dims)) - 1
    chosen = counts[counts > 0] >= share * np.prod(upper - lower + 1, axis=1)
    return Boxes(np.zeros(len(cells), np.int64), cells, lower, upper).rows(chosen)


def voxels_per_cell(grid: Grid, mask: Bits) -> NDArray[np.int32]:
    """[cells] how many voxels of a mask each cell of level 0 holds."""
    sums = mask.mask().reshape(grid.dims).astype(np.int32)
    for axis, size in enumerate(grid.dims):
        sums = np.add.reduceat(sums, np.arange(0, size, SMALLEST), axis=axis)
    return sums.reshape(-1)


def fitted(grid: Grid, boxes: Boxes, most: int, before: NDArray[np.int64]) -> Boxes:
    """At most `most` boxes that hold what `boxes`, of level 0, hold, about as little other space as possible.

    Every price of a box has a best set of cells; the lowest price whose set is small enough is taken. `before` [k] are
    the `places` of an earlier cover, which are kept where they are nearly as good.
    """
    if len(boxes) <= most:
        return boxes
    levels = _octree(boxes)
    counts, divided = _best_divisions(grid, levels, before)
    affordable = np.flatnonzero(counts <= most)
    if len(affordable) == 0:
        roots = levels[-1].boxes
        return _by_cell(HIGHEST_LEVEL, np.zeros_like(roots.cells), roots.lower, roots.upper).boxes
    return _divided(levels, [split[affordable[0]] for split in divided])


def _lattice(grid: Grid) -> tuple[int, ...]:
    """Cells of level 0 along each axis."""
    return tuple(-(-n // SMALLEST) for n in grid.dims)


@dataclass(frozen=True)
class _Level:
    """All cells of one level."""

    boxes: Boxes
    children: NDArray[np.int64]
    """[n] rows of the level below (or of what the boxes were made of), cell by cell."""
    starts: NDArray[np.int64]
    """[c] where each cell's children begin."""


def _by_cell(level: int, cells: NDArray[np.int64], lower: NDArray[np.int64], upper: NDArray[np.int64]) -> _Level:
    """One box per distinct cell about the boxes (lower, upper) [n, 3] that lie in it."""
    if len(cells) == 0:
        nothing = np.zeros(0, np.int64)
        return _Level(Boxes(nothing, cells, lower, upper), nothing, nothing)
    keys = (cells[:, 0] << 40) | (cells[:, 1] << 20) | cells[:, 2]
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    boxes = Boxes(
        np.full(len(starts), level),
        cells[order[starts]],
        np.minimum.reduceat(lower[order], starts, axis=0),
        np.maximum.reduceat(upper[order], starts, axis=0),
    )
    return _Level(boxes, order, starts)


def _octree(leaves: Boxes) -> list[_Level]:
    """From the leaves up to one cell, or to the highest level."""
    rows = np.arange(len(leaves))
    levels = [_Level(leaves, rows, rows)]
    while len(levels[-1].boxes) > 1 and len(levels) <= HIGHEST_LEVEL:
        below = levels[-1].boxes
        levels.append(_by_cell(len(levels), below.cells // 2, below.lower, below.upper))
    return levels


def _best_divisions(
    grid: Grid, levels: list[_Level], before: NDArray[np.int64]
) -> tuple[NDArray[np.int64], list[Bool]]:
    """For every price the number of boxes [prices], and per level which cells are divided [prices, c].

    A cell is divided where its children together cost less than its own box, which costs its space and one price.
    """
    costs, counts = np.zeros((len(PRICES), 0)), np.zeros((len(PRICES), 0), np.int64)
    divided: list[Bool] = []
    for number, level in enumerate(levels):
        space = np.prod(level.boxes.upper - level.boxes.lower + 1, axis=1).astype(np.float64)
        space *= np.where(np.isin(level.boxes.places(grid), before), LOYALTY, 1.0)
        whole = space + PRICES[:, None]
        if number == 0:
            costs, counts = whole, np.ones(whole.shape, np.int64)
            divided.append(np.zeros(whole.shape, np.bool_))
            continue
        apart = np.add.reduceat(costs[:, level.children], level.starts, axis=1)
        numbers = np.add.reduceat(counts[:, level.children], level.starts, axis=1)
        divide = apart < whole
        costs, counts = np.where(divide, apart, whole), np.where(divide, numbers, 1)
        divided.append(divide)
    return counts.sum(axis=1), divided


def _divided(levels: list[_Level], divided: list[Bool]) -> Boxes:
    """The boxes that are left when, from the roots down, the cells [c] of each level are divided as told."""
    found: list[Boxes] = []
    reached = np.ones(len(levels[-1].boxes), np.bool_)
    for level, divide in zip(reversed(levels), reversed(divided), strict=True):
        found.append(level.boxes.rows(reached & ~divide))
        sizes = np.diff(level.starts, append=len(level.children))
        below = np.zeros(len(level.children), np.bool_)
        below[level.children] = np.repeat(reached & divide, sizes)
        reached = below
    return found[0].joined(*found[1:])
