"""How Gaussians creep in the frames of their nodes: motion that gradient steps have taken up in a node's stead."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from twin_node.model.cells import Cells
from twin_node.model.gaussians import Gaussians
from twin_node.model.nodes import Nodes
from twin_node.model.rotations import rotate
from twin_node.scene import Float64


class Drift:
    """Remembers where Gaussians were in their nodes' frames when the flow was looked at last."""

    def __init__(self) -> None:
        self._ids = torch.zeros(0, dtype=torch.int64)
        self._nodes = torch.zeros(0, dtype=torch.int64)
        self._means = torch.zeros(0, 3)

    def of(self, gaussians: Gaussians, rows: Tensor, cells: Cells, nodes: Nodes) -> Float64:
        """[c, 3] m in `base_link` that the Gaussians `rows` [m] of each cell have crept since the last call, mean.

        0 for those that are new or have changed their node.
        """
        ids, means = gaussians.ids[rows].cpu(), gaussians.means[rows].cpu()
        carriers = gaussians.nodes[rows].cpu()
        homes = nodes.ids[carriers]
        order = ids.argsort()
        crept = torch.zeros(len(rows), 3, dtype=torch.float64)
        if len(self._ids):
            at = torch.searchsorted(self._ids, ids).clamp_max(len(self._ids) - 1)
            same = (self._ids[at] == ids) & (self._nodes[at] == homes)
            moved = rotate(nodes.quats[carriers], (means - self._means[at]).double())
            crept = torch.where(same[:, None], moved, 0.0)
        self._ids, self._nodes, self._means = ids[order], homes[order], means[order]
        sums = np.zeros((len(cells), 3))
        np.add.at(sums, cells.of, crept.numpy())
        return sums / np.maximum(np.bincount(cells.of, minlength=len(cells)), 1)[:, None]
