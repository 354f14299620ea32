"""The rim about the workspace in which things are followed before they come in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import WORD, Bits
from twin_node.forecast.grid import MOST_VOXELS
from twin_node.scene import Grid

RIM_S = 0.25
"""How long before it comes in a person is seen, s: the longest horizon."""


class Margin:
    """A grid and a larger one about it, on the same lattice."""

    def __init__(self, inner: Grid, width_m: float, most_voxels: int = MOST_VOXELS) -> None:
        """`width_m`: of the rim; less where the larger grid would exceed `most_voxels`.

        None below: under most of a workspace lies a table or the floor, and who comes up beside a table is seen late.
        """
        rim = int(np.ceil(width_m / inner.voxel_size))
        while rim > 0 and np.prod(np.array(inner.dims) + rim * _SIDES) > most_voxels:
            rim -= 1
        self.inner = inner
        self._offset = rim * np.array([1, 1, 0])
        dims = np.array(inner.dims) + rim * _SIDES
        origin = inner.origin - self._offset * inner.voxel_size
        self.outer = Grid(origin, inner.voxel_size, (int(dims[0]), int(dims[1]), int(dims[2])))

    def places(self, outer: NDArray[np.int32]) -> NDArray[np.int32]:
        """Voxel coordinates [3, n] in the inner grid, also of voxels beside it, of coordinates in the outer one."""
        return outer - self._offset[:, None].astype(np.int32)

    def cropped(self, mask: Bits) -> Bits:
        """A mask of the inner grid of one of the outer grid, which has no rim below."""
        x, y, _ = self._offset
        nx, ny, nz = self.inner.dims
        words = mask.words[x : x + nx, y : y + ny, : -(-nz // WORD)].copy()
        if nz % WORD:
            words[..., -1] &= np.uint64((1 << nz % WORD) - 1)
        return Bits(self.inner.dims, words)

    def outward(self, inner: NDArray[np.int64]) -> NDArray[np.int64]:
        """Flat indices [n] in the outer grid of flat indices [n] in the inner one; they rise where those do."""
        places = np.stack(np.unravel_index(inner, self.inner.dims)) + self._offset[:, None]
        outer: NDArray[np.int64] = np.ravel_multi_index(tuple(places), self.outer.dims).astype(np.int64)
        return outer


_SIDES = np.array([2, 2, 1])
"""Sides along x, y and z that the rim is on."""
