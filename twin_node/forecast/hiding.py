"""What may be in the space that no camera sees, and what may come out of it."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twin_node.forecast.bound import PERSON_SPEED
from twin_node.scene import Bool, Grid

HAND_M = 0.04
"""Thinnest thing that is looked for, m: a hand, as detection capability is told in ISO 13855."""
COMES_TO_REST_S = 1.0
"""What went out of sight and is attached to nothing lies still after this long, s: a ball rolls out of it sooner."""
LONGEST_GAP_S = 0.5
"""After a longer time without evidence nothing is known of space that is not seen, s."""


@dataclass(frozen=True)
class Hidden:
    """Flat masks [grid.size] of unknown space; what is in neither was seen empty, and nothing can have got in since."""

    reachable: Bool
    """Something may come out at any time: it hangs together with what moves, or with what lies beyond the grid."""
    maybe_full: Bool
    """Something may lie there, but nothing comes out: it was never seen empty, and nothing reaches it."""

    def masked(self, mask: Callable[[Bool], Bool]) -> Hidden:
        """Both masks changed in the same way, such as cropped."""
        return Hidden(mask(self.reachable), mask(self.maybe_full))


class HidingPlaces:
    """Follows what may be hidden in one grid, state by state.

    People are in one piece and larger than any shadow: an unseen hand hangs on an arm that is unseen as far as the
    grid's side, or until where it is seen to move. Unknown space is therefore reachable where a hand's width of unknown
    or moving space leads to either. What is loose, such as a ball, gets in only where something was seen to move, and
    rests soon after. All else keeps what it had when it was last seen. Nothing comes through the grid's bottom, which
    is a table or a floor.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._width = max(1, int(HAND_M / grid.voxel_size))
        self._maybe_full = np.ones(grid.size, np.bool_)
        self._reached_ns = np.zeros(_half(np.zeros(grid.dims, np.bool_)).shape, np.int64)
        self._stamp: int | None = None

    def update(self, stamp: int, unknown: Bool, moving: Bool, standing: Bool) -> Hidden:
        """What flat masks [grid.size] of unknown, moving and standing voxels at a time (ns, rising) leave possible."""
        elapsed_s = np.inf if self._stamp is None else (stamp - self._stamp) * 1e-9
        started = self._stamp is None
        self._stamp = stamp
        dims = self._grid.dims
        beside = _widened(standing.reshape(dims), 1, 1)
        beside[..., 0] = True
        passable = (unknown.reshape(dims) & ~beside) | moving.reshape(dims)
        ways = _half(_wide(passable, self._width))
        self._reached_ns = self._spread(stamp, elapsed_s, ways, _half(moving.reshape(dims)))
        reached = _widened(self._reached_ns > 0, 1, 1)
        if not started and elapsed_s > LONGEST_GAP_S:
            self._maybe_full[:] = True
        reachable = unknown & _doubled(reached, dims).reshape(-1)
        self._maybe_full &= unknown
        self._maybe_full |= reachable
        return Hidden(reachable, self._maybe_full & ~reachable)

    def _spread(self, stamp: int, elapsed_s: float, ways: Bool, moving: Bool) -> NDArray[np.int64]:
        """When each cell was last reached by what is attached, ns; 0 where that is over, or never was."""
        sources = self._reached_ns
        sources[moving] = stamp
        for face in (sources[0], sources[-1], sources[:, 0], sources[:, -1], sources[:, :, -1]):
            face[...] = stamp
        if np.isfinite(elapsed_s):
            cells = int(np.ceil(PERSON_SPEED * min(elapsed_s, LONGEST_GAP_S) / (2 * self._grid.voxel_size)))
            sources = ndimage.maximum_filter(sources, 2 * cells + 1)
        labels, count = ndimage.label(ways, np.ones((3, 3, 3), np.bool_))
        newest = np.zeros(count + 1, np.int64)
        np.maximum.at(newest, labels[ways], sources[ways])
        newest[newest < stamp - round(COMES_TO_REST_S * 1e9)] = 0
        reached: NDArray[np.int64] = np.where(ways, newest[labels], 0)
        return reached


def _wide(mask: Bool, width: int) -> Bool:
    """The voxels of a mask [nx, ny, nz] that lie in a cube of it, `width` voxels wide."""
    corners = mask[tuple(slice(0, max(n - width + 1, 0)) for n in mask.shape)].copy()
    for offset in itertools.product(range(width), repeat=3):
        corners &= mask[tuple(slice(o, o + n) for o, n in zip(offset, corners.shape, strict=True))]
    wide = np.zeros(mask.shape, np.bool_)
    for offset in itertools.product(range(width), repeat=3):
        wide[tuple(slice(o, o + n) for o, n in zip(offset, corners.shape, strict=True))] |= corners
    return wide


def _widened(mask: Bool, below: int, above: int) -> Bool:
    """A mask [nx, ny, nz] and so many voxels below and above each of it, along every axis."""
    for axis in range(3):
        source, mask = np.moveaxis(mask, axis, 0), mask.copy()
        target = np.moveaxis(mask, axis, 0)
        for step in range(1, below + 1):
            target[:-step] |= source[step:]
        for step in range(1, above + 1):
            target[step:] |= source[:-step]
    return mask


def _half(mask: Bool) -> Bool:
    """Cells [ceil(n / 2)] of two by two by two voxels that hold any of a mask [nx, ny, nz]."""
    padded = np.pad(mask, [(0, n % 2) for n in mask.shape])
    padded = padded[::2] | padded[1::2]
    padded = padded[:, ::2] | padded[:, 1::2]
    halved: Bool = padded[..., ::2] | padded[..., 1::2]
    return halved


def _doubled(cells: Bool, dims: tuple[int, int, int]) -> Bool:
    """The voxels [nx, ny, nz] of cells."""
    wide = cells.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)
    return wide[: dims[0], : dims[1], : dims[2]]
