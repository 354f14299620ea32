"""How Gaussians creep in the frames of their nodes: motion that gradient steps have taken up in a node's stead."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from twin_node.geometry import rotation_from_quat
from twin_node.model.cells import Cells
from twin_node.model.gaussians import Gaussians
from twin_node.model.kernels import kernels_for
from twin_node.model.node_requests import CreepRequest
from twin_node.model.nodes import Nodes
from twin_node.native_library import addresses_of
from twin_node.scene import Float64


class Creep:
    """Remembers where Gaussians were in their nodes' frames when the flow was looked at last."""

    def __init__(self, capacity: int) -> None:
        self._ids = np.full(capacity, -1, np.int64)
        self._homes = np.full(capacity, -1, np.int64)
        self._means = np.zeros((capacity, 3), np.float32)

    def of(self, gaussians: Gaussians, rows: Tensor, cells: Cells, nodes: Nodes) -> Float64:
        """[c, 3] m in `base_link` that the Gaussians `rows` [m] of each cell have crept since the last call, mean.

        0 for those that are new or have changed their node.
        """
        mean = self._crept(gaussians, rows, cells, nodes.ids.numpy()[cells.nodes])
        turned: Float64 = (rotation_from_quat(nodes.quats.numpy())[cells.nodes] @ mean[..., None])[..., 0]
        return turned

    def _crept(self, gaussians: Gaussians, rows: Tensor, cells: Cells, homes: NDArray[np.int64]) -> Float64:
        """[c, 3] m the same in the frames of the nodes, whose ids are `homes` [c]."""
        library = kernels_for(gaussians.values.device)
        if library is None:
            return self._crept_reference(gaussians, rows, cells, homes)
        mean, of, at = np.empty((len(cells), 3)), np.ascontiguousarray(cells.of), rows.contiguous()
        arrays = (of, np.ascontiguousarray(homes), self._ids, self._homes, self._means, mean)
        pointers = (*(t.data_ptr() for t in (at, gaussians.ids, gaussians.values)), *addresses_of(*arrays))
        library.run(CreepRequest(len(of), len(cells), len(self._ids), *pointers))
        return mean

    def _crept_reference(self, gaussians: Gaussians, rows: Tensor, cells: Cells, homes: NDArray[np.int64]) -> Float64:
        """The same in NumPy, on any device: the reference of the compiled kernel."""
        at, ids = rows.cpu().numpy(), gaussians.ids[rows].cpu().numpy()
        means, homes = gaussians.means[rows].cpu().numpy(), homes[cells.of]
        same = (self._ids[at] == ids) & (self._homes[at] == homes)
        crept = np.where(same[:, None], means - self._means[at], 0.0)
        self._ids[:] = -1
        self._ids[at], self._homes[at], self._means[at] = ids, homes, means
        shares = 1 / np.maximum(np.bincount(cells.of, minlength=len(cells)), 1)
        return np.stack([np.bincount(cells.of, weights=axis, minlength=len(cells)) * shares for axis in crept.T], 1)
