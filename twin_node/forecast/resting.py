"""What moved a while ago and stands now: people who keep still look like furniture, and may start again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Bits
from twin_node.forecast.kernel_requests import RestRequest
from twin_node.forecast.kernels import kernels
from twin_node.forecast.parts import split
from twin_node.forecast.specks import of_patches, of_things
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Grid

RESTING_S = 20.0
"""How long what has moved by itself may start again, s: one start spoils the forecasts of one horizon of 0.2 s, and a
target of 99 % allows one in a hundred. Longer rests are those of things that somebody put down."""
LIMB_M = 0.5
"""How far what rests of somebody may be from what else moves or rests of them, m: an arm from shoulder to wrist."""
_CELL = 8
"""Voxels along a cell in which distances are told."""
_RESTING_NS = round(RESTING_S * 1e9)
_NEVER = np.iinfo(np.int64).min // 2


class Resting:
    """Follows which standing voxels of one grid moved of late, state by state."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._memory = Memory.of_nothing(grid)
        self._stood = Bits.none(grid.dims)
        """What has stood while nothing had moved in it, as long as something stands there or next to it."""

    def update(self, stamp: int, moving: NDArray[np.int64], standing: Bits) -> NDArray[np.int64]:
        """Flat indices [n] of voxels that stand at `stamp` (ns, rising), and did not when something moved in them.

        `moving` [m]: flat indices where something moves that may rest and start again; `standing`: what stands. A table
        that a hand passes over stood all along: it is none of these. Its edges, which at times are found to stand only
        after somebody passed them, are none either: a layer about what stood counts only where it may be a limb of
        somebody near it, who moves or rests, and where it touches them or a hand fits in it. Nor is what had stood
        there before: noise, and pixels wider than voxels, now find the surface of a table and now do not. Specks that
        no hand fits in, and that hang on nothing larger, are nobody.
        """
        found = rested(self._memory, stamp, moving, standing)
        alone = standing.without(self._memory.moved)
        self._stood = (self._stood | alone) & standing.grown()
        if len(found) == 0:
            return found
        touches = alone.grown().holds(found)
        layer, bodies = found[touches], Bits.of_indices(self._grid.dims, found[~touches])
        stood = self._stood.holds(layer)
        self._memory.moved.remove(layer[stood])
        layer = layer[~stood]
        somebody = self._without_specks(bodies | Bits.of_indices(self._grid.dims, moving))
        layer = layer[self._is_within_reach(layer, somebody)]
        limbs = layer[self._may_be_limb(layer, somebody)]
        return np.sort(np.concatenate([somebody[bodies.holds(somebody)], limbs]))

    def _may_be_limb(self, layer: NDArray[np.int64], somebody: NDArray[np.int64]) -> Bool:
        """[n] which voxels of a layer touch somebody or one another in a patch; both are flat indices."""
        if len(layer) == 0:
            return np.zeros(0, np.bool_)
        touches = Bits.of_indices(self._grid.dims, somebody).grown().holds(layer)
        return touches | of_patches(self._grid, layer)

    def _without_specks(self, voxels: Bits) -> NDArray[np.int64]:
        """Flat indices [n] of those of the voxels that hang together with enough others."""
        indices = voxels.indices()
        parts = split(self._grid, indices, np.ones(len(indices), np.bool_))
        return indices[of_things(self._grid, parts)[parts.labels]]

    def _is_within_reach(self, voxels: NDArray[np.int64], others: NDArray[np.int64]) -> Bool:
        """[n] which `voxels` are at most `LIMB_M` from any of the `others`, to a cell; both are flat indices."""
        from scipy import ndimage  # loads slowly, and who only reads parameters never asks

        if len(voxels) == 0 or len(others) == 0:
            return np.zeros(len(voxels), np.bool_)
        is_apart = np.ones(tuple(-(-size // _CELL) for size in self._grid.dims), np.bool_)
        is_apart[self._cells(others)] = False
        away_m = ndimage.distance_transform_edt(is_apart) * (_CELL * self._grid.voxel_size)
        within: Bool = away_m[self._cells(voxels)] <= LIMB_M
        return within

    def _cells(self, voxels: NDArray[np.int64]) -> tuple[NDArray[np.intp], ...]:
        return tuple(axis // _CELL for axis in np.unravel_index(voxels, self._grid.dims))


@dataclass(frozen=True)
class Memory:
    """When something moved in one grid; `rested` changes it."""

    moved_at: NDArray[np.int64]
    """[voxels] ns."""
    moved: Bits
    """Where something moved that has not been found to have been too long ago."""
    room: NDArray[np.int64]
    """[voxels] for what a kernel finds: memory is taken by what is written alone."""

    @staticmethod
    def of_nothing(grid: Grid) -> Memory:
        """Before anything moved."""
        room = np.empty(grid.size, np.int64)
        return Memory(np.full(grid.size, _NEVER, np.int64), Bits.none(grid.dims), room)


def rested(memory: Memory, stamp: int, moving: NDArray[np.int64], standing: Bits) -> NDArray[np.int64]:
    """What `Resting.update` finds; the memory is brought up to date.

    Compiled; `rested_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return rested_reference(memory, stamp, moving, standing)
    count, places = np.empty(1, np.int64), np.ascontiguousarray(moving, np.int64)
    arrays = (places, np.ascontiguousarray(standing.words), memory.moved_at, memory.moved.words, memory.room, count)
    compiled.run(RestRequest(*standing.dims, len(places), stamp, stamp - _RESTING_NS, *addresses_of(*arrays)))
    return memory.room[: count[0]].copy()


def rested_reference(memory: Memory, stamp: int, moving: NDArray[np.int64], standing: Bits) -> NDArray[np.int64]:
    """What `rested` does."""
    started = moving[~standing.holds(moving)]
    memory.moved_at[started] = stamp
    memory.moved.add(started)
    stands = (memory.moved & standing).indices()
    is_recent = memory.moved_at[stands] > stamp - _RESTING_NS
    memory.moved.remove(stands[~is_recent])
    return stands[is_recent]
