"""What carries Gaussians from their node's frame to `base_link`: the pose of the node, and the field where it bends."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from twin_node.model.field import HexPlane
from twin_node.model.gaussians import LOG_SCALE, LOGIT, MEAN, QUAT, RGB, Gaussians
from twin_node.model.nodes import Nodes, Poses
from twin_node.model.rendering import Splats
from twin_node.model.rotations import quat_from_vector, quat_product, rotate
from twin_node.scene import Tier

GRID_RATE, DECODER_RATE = 1.6e-3, 1.6e-4
"""Adam's rates of planes and decoder (4DGS, `arguments/dynerf`)."""


class Motion:
    """Nodes and, for the DEFORMABLE among their Gaussians, a residual field over the window."""

    def __init__(self, nodes: Nodes, field: HexPlane) -> None:
        self.nodes = nodes
        self.field = field
        decoder = [field.hidden, field.hidden_bias, field.out]
        self._optimiser = torch.optim.Adam(
            [{"params": [field.space, field.time], "lr": GRID_RATE}, {"params": decoder, "lr": DECODER_RATE}]
        )

    @property
    def bends(self) -> bool:
        """Whether any node is DEFORMABLE, so that the field is evaluated at all."""
        return bool((self.nodes.alive & (self.nodes.tiers == int(Tier.DEFORMABLE))).any())

    def poses(self, offsets_s: Sequence[float]) -> Poses:
        """The nodes at their stamp plus each of `offsets_s` (s)."""
        return self.nodes.extrapolated(list(offsets_s))

    def stamps(self, offsets_s: Sequence[float]) -> list[int]:
        """The same times in ns."""
        return [self.nodes.stamp + round(offset * 1e9) for offset in offsets_s]

    def place(self, gaussians: Gaussians, rows: Tensor, poses: Poses, stamps: list[int]) -> Splats:
        """Gaussians `rows` [n] in `base_link` at each of T times."""
        return self.place_values(gaussians.values[rows], gaussians, rows, poses, stamps)

    def place_values(
        self, values: Tensor, gaussians: Gaussians, rows: Tensor, poses: Poses, stamps: list[int]
    ) -> Splats:
        """The same with attributes `values` [n, 14] in place of those stored: where a gradient is wanted."""
        times = len(stamps)
        means = values[:, MEAN].expand(times, -1, -1)
        quats = values[:, QUAT].expand(times, -1, -1)
        carriers = gaussians.nodes[rows]
        if self.bends:
            means, quats = self._bend(means, quats, carriers, gaussians.tiers[rows], stamps)
        if bool((carriers >= 0).any()):
            carried = (carriers >= 0)[None, :, None]
            row = carriers.clamp_min(0).cpu()
            turn = poses.quats[:, row].to(values)
            means = torch.where(carried, rotate(turn, means) + poses.positions[:, row].to(values), means)
            quats = torch.where(carried, quat_product(turn, quats), quats)
        return Splats(means, quats, values[:, LOG_SCALE].exp(), values[:, LOGIT][:, 0].sigmoid(), values[:, RGB])

    def slide(self, stamp: int) -> None:
        """The window now ends at `stamp` (ns)."""
        if not self.field.stamps or stamp > self.field.stamps[-1]:
            self.field.slide(stamp)

    def descend(self) -> None:
        """One step on the field by the gradients that it holds; taken only where all of them are finite."""
        gradients = [p.grad for p in self.field.parameters() if p.grad is not None]
        if gradients and all(bool(torch.isfinite(g).all()) for g in gradients):
            self._optimiser.step()
        self._optimiser.zero_grad()

    def _bend(
        self, means: Tensor, quats: Tensor, carriers: Tensor, tiers: Tensor, stamps: list[int]
    ) -> tuple[Tensor, Tensor]:
        """Means [T, n, 3] and quaternions [T, n, 4] with the residual of the DEFORMABLE ones added."""
        chosen = torch.nonzero(tiers == int(Tier.DEFORMABLE))[:, 0]
        if not len(chosen):
            return means, quats
        anchors = self.nodes.anchors[carriers[chosen].cpu()].to(means)
        residual = self.field.residual(means[0, chosen] + anchors, stamps)
        turned = quat_product(quat_from_vector(residual.rotations), quats[:, chosen])
        return (
            means.clone().index_add(1, chosen, residual.offsets),
            quats.clone().index_copy(1, chosen, turned),
        )
