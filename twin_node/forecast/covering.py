"""Covers: few boxes about each of several sets of voxels, found in one compiled call."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Bits
from twin_node.forecast.boxes import HIGHEST_LEVEL, LOYALTY, PRICES, fitted, mostly_full, smallest_boxes
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.kernel_requests import CoverRequest, CoverTask
from twin_node.forecast.kernels import Kernels, kernels
from twin_node.native_library import addresses_of
from twin_node.scene import Grid, UInt32


@dataclass(frozen=True)
class Share:
    """The cells that a mask fills mostly."""

    mask: Bits
    least: float
    """Share of a cell's voxels from which on it is held, whole."""


@dataclass(frozen=True)
class Wanted:
    """What a few boxes are to hold."""

    grid: Grid
    most: int
    """Boxes at most."""
    prefix: int
    """Of their ids, above the 24 bits that number their cells: 0 to 255."""
    voxels: tuple[NDArray[np.integer], ...] | Share
    """At most two lists of flat indices in any order, or a mask's cells."""


@dataclass(frozen=True)
class Covers:
    """The boxes, one set after the other."""

    ids: UInt32
    """[c] prefix << 24 | level << 21 | flat index of the cell on the lattice of level 0."""
    lower: NDArray[np.int64]
    """[c, 3] first voxel."""
    upper: NDArray[np.int64]
    """[c, 3] last voxel."""
    counts: NDArray[np.int64]
    """[n] boxes of each set."""


def covers(wanted: Sequence[Wanted], before: UInt32) -> Covers:
    """Boxes for each of what is wanted, on about as little space as possible (`boxes.fitted`).

    `before` [k]: ids of an earlier cover, whose boxes are kept where they are nearly as good. Compiled;
    `covers_reference` where that cannot be. Raises `ForecastError` for voxels that are not in their grid, and for a
    mask of another.
    """
    for one in wanted:
        _require_inside(one)
    compiled = kernels()
    return covers_reference(wanted, before) if compiled is None else _covers_by(compiled, wanted, before)


def _require_inside(wanted: Wanted) -> None:
    dims = wanted.grid.dims
    if isinstance(wanted.voxels, Share):
        if wanted.voxels.mask.dims != dims:
            raise ForecastError(
                f"cover: expected a mask of {dims} voxels, as the grid has, found {wanted.voxels.mask.dims}; give that "
                "of this grid"
            )
        return
    for indices in wanted.voxels:
        most = int(indices.max(initial=0))
        least = 0 if indices.dtype.kind == "u" else int(indices.min(initial=0))
        if least < 0 or most >= wanted.grid.size:
            raise ForecastError(
                f"cover: expected flat indices of the grid's {wanted.grid.size} voxels, found "
                f"{least if least < 0 else most}; check who made the occupancy"
            )


def _covers_by(compiled: Kernels, wanted: Sequence[Wanted], before: UInt32) -> Covers:
    held = [_lists(one.voxels) for one in wanted]  # alive until the call is over
    tasks = (CoverTask * len(wanted))(
        *(
            CoverTask(
                *(*one.grid.dims, one.most, one.prefix, len(first), len(second)),
                *addresses_of(first, second, words),
                one.voxels.least if isinstance(one.voxels, Share) else 0.0,
            )
            for one, (first, second, words) in zip(wanted, held, strict=True)
        )
    )
    room = sum(one.most for one in wanted)
    ids, corners = np.empty(room, np.uint32), np.empty((2, room, 3), np.int64)
    counts, given = np.empty(len(wanted), np.int64), np.ascontiguousarray(before, np.uint32)
    arrays = (PRICES, given, ids, *corners, counts)
    sizes = (len(wanted), len(given), len(PRICES), HIGHEST_LEVEL, LOYALTY)
    compiled.run(CoverRequest(*sizes, *addresses_of(*arrays), tasks))
    total = int(counts.sum())
    return Covers(ids[:total], corners[0, :total], corners[1, :total], counts)


_NO_VOXELS = np.zeros(0, np.uint32)


def _lists(
    voxels: tuple[NDArray[np.integer], ...] | Share,
) -> tuple[UInt32, UInt32, NDArray[np.uint64] | None]:
    """Two lists of voxels, and the words of a mask."""
    if isinstance(voxels, Share):
        return _NO_VOXELS, _NO_VOXELS, np.ascontiguousarray(voxels.mask.words)
    first, second, *_ = (*(np.ascontiguousarray(one, np.uint32) for one in voxels), _NO_VOXELS, _NO_VOXELS)
    return first, second, None


def covers_reference(wanted: Sequence[Wanted], before: UInt32) -> Covers:
    """What `covers` does."""
    found, ids = [], []
    for one in wanted:
        if isinstance(one.voxels, Share):
            smallest = mostly_full(one.grid, one.voxels.mask, one.voxels.least)
        else:
            smallest = smallest_boxes(one.grid, np.concatenate(one.voxels))
        known = before.astype(np.int64)
        mine = fitted(one.grid, smallest, one.most, known[known >> 24 == one.prefix] & 0xFFFFFF)
        found.append(mine)
        ids.append((one.prefix << 24) | mine.places(one.grid))
    whole = found[0].joined(*found[1:])
    counts = np.array([len(boxes) for boxes in found], np.int64)
    return Covers(np.concatenate(ids).astype(np.uint32), whole.lower, whole.upper, counts)
