"""Small pieces of the bodies that nodes carry: the flow is listened to per piece, so that bodies can be told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from twin_node.model.gaussians import RGB, Gaussians
from twin_node.model.kernels import kernels_for
from twin_node.model.node_requests import CellRequest
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float64

CELL_M = 0.06
"""Side of a cell, m: a finger's or a gripper's width, and a few pixels of a small image at arm's length."""
AXIS_BITS = 10
"""Of a cell's place along one axis: 1,024 cells, so that no body is too large."""


@dataclass(frozen=True)
class Cells:
    """Cubes of the frames of M nodes that hold the Gaussians that these carry."""

    keys: NDArray[np.int64]
    """[c] strictly increasing; the same place in the same node has the same key in every set."""
    nodes: NDArray[np.int64]
    """[c] row of the node that each belongs to."""
    founders: NDArray[np.int64]
    """[c] id of the node that carried its Gaussians first."""
    of: NDArray[np.int64]
    """[m] the cell, 0 to c - 1, of each Gaussian."""
    centres: Float64
    """[c, 3] m, mean place of the Gaussians of each in `base_link`."""
    rgb: Float64
    """[c, 3] mean colour of the Gaussians of each, 0 to 1."""

    def __len__(self) -> int:
        return len(self.keys)

    @classmethod
    def none(cls) -> Cells:
        """No cells at all."""
        nobody = np.zeros(0, np.int64)
        return cls(nobody, nobody, nobody, nobody, np.zeros((0, 3)), np.zeros((0, 3)))

    def found_in(self, others: Cells) -> NDArray[np.int64]:
        """[c] where each of these is among `others`; -1 where it is not."""
        if not len(others):
            return np.full(len(self), -1, np.int64)
        at = np.minimum(np.searchsorted(others.keys, self.keys), len(others) - 1)
        return np.where(others.keys[at] == self.keys, at, -1)

    def are_among(self, keys: NDArray[np.int64]) -> Bool:
        """[c] which of these have one of `keys` [k], which increase; `np.isin` sorts for ten times as long."""
        if not len(keys):
            return np.zeros(len(self), bool)
        among: Bool = keys[np.minimum(np.searchsorted(keys, self.keys), len(keys) - 1)] == self.keys
        return among

    def middles(self, count: int) -> Float64:
        """[count, 3] m, mean centre of the cells of each node; 0 where it has none."""
        sums = np.stack([np.bincount(self.nodes, weights=axis, minlength=count) for axis in self.centres.T], 1)
        return sums / np.maximum(np.bincount(self.nodes, minlength=count), 1)[:, None]


def cells_of(gaussians: Gaussians, rows: Tensor, means: Tensor) -> Cells:
    """The cells of Gaussians `rows` [m], all of which a node carries, at `means` [m, 3] (m) in `base_link`."""
    library, count = kernels_for(gaussians.values.device), len(rows)
    if library is None:
        return cells_reference(gaussians, rows, means)
    keys, carriers, of = (np.empty(count, np.int64) for _ in range(3))
    centres, rgb, found = np.empty((count, 3)), np.empty((count, 3)), np.empty(1, np.int64)
    given = [t.contiguous() for t in (rows, gaussians.nodes, gaussians.founders, gaussians.values, means.detach())]
    pointers = (*(t.data_ptr() for t in given), *addresses_of(keys, carriers, of, centres, rgb, found))
    library.run(CellRequest(count, AXIS_BITS, CELL_M, *pointers))
    cells = int(found[0])
    return Cells(keys[:cells], carriers[:cells], keys[:cells] >> 3 * AXIS_BITS, of, centres[:cells], rgb[:cells])


def cells_reference(gaussians: Gaussians, rows: Tensor, means: Tensor) -> Cells:
    """The same in NumPy, on any device: the reference of the compiled kernel."""
    carriers, local = gaussians.nodes[rows].cpu().numpy(), gaussians.means[rows].cpu().numpy()
    here = means.cpu().double().numpy()
    half = 1 << (AXIS_BITS - 1)
    voxels = np.clip(np.floor(local / CELL_M).astype(np.int64), -half, half - 1) + half
    place = (voxels[:, 0] << 2 * AXIS_BITS) | (voxels[:, 1] << AXIS_BITS) | voxels[:, 2]
    keys = (gaussians.founders[rows].cpu().numpy() << 3 * AXIS_BITS) | place
    found, first, of = np.unique(keys, return_index=True, return_inverse=True)
    of = of.reshape(-1)
    count = np.bincount(of, minlength=len(found))
    shown: Float64 = np.concatenate([here, gaussians.values[rows, RGB].cpu().numpy()], 1)
    own = np.zeros((len(found), shown.shape[1]))
    np.add.at(own, of, shown)
    own /= np.maximum(count, 1)[:, None]
    return Cells(found, carriers[first], found >> 3 * AXIS_BITS, of, own[:, :3], own[:, 3:])
