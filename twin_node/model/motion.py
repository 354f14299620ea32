"""What carries Gaussians from their node's frame to `base_link`: the pose of the node, and the field where it bends."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.adam import Adam
from twin_node.model.carriage import Bend, carry
from twin_node.model.field import HexPlane
from twin_node.model.gaussians import MEAN, QUAT, Gaussians, Population, activated
from twin_node.model.nodes import Nodes, Poses
from twin_node.model.rendering import Splats
from twin_node.model.rotations import quat_from_vector
from twin_node.model.writes import Writes
from twin_node.scene import Tier

GRID_RATE, DECODER_RATE = 1.6e-3, 1.6e-4
"""Adam's rates of planes and decoder (4DGS, `arguments/dynerf`)."""


class Motion:
    """Nodes and, for the DEFORMABLE among their Gaussians, a residual field over the window."""

    def __init__(self, nodes: Nodes, field: HexPlane) -> None:
        self.nodes = nodes
        self.field = field
        grids, decoder = (field.space, field.time), (field.hidden, field.hidden_bias, field.out)
        self._adam = Adam([*((p, GRID_RATE) for p in grids), *((p, DECODER_RATE) for p in decoder)])
        self._bends, self._writes = False, Writes()

    @property
    def bends(self) -> bool:
        """Whether any node is DEFORMABLE, so that the field is evaluated at all.

        Found anew only when lives or tiers have changed: a set asks a dozen times.
        """
        alive, tiers = self.nodes.alive, self.nodes.tiers
        if self._writes.have_come(alive, tiers):
            self._bends = bool((alive.numpy() & (tiers.numpy() == int(Tier.DEFORMABLE))).any())
        return self._bends

    def poses(self, offsets_s: Sequence[float]) -> Poses:
        """The nodes at their stamp plus each of `offsets_s` (s)."""
        return self.nodes.extrapolated(list(offsets_s))

    def stamps(self, offsets_s: Sequence[float]) -> list[int]:
        """The same times in ns."""
        return [self.nodes.stamp + round(offset * 1e9) for offset in offsets_s]

    def place(self, gaussians: Gaussians, rows: Tensor, poses: Poses, stamps: list[int]) -> Splats:
        """Gaussians `rows` [n] in `base_link` at each of T times."""
        if not self.bends and not torch.is_grad_enabled() and splat.has_kernels(gaussians.values.device):
            placed = splat.place(gaussians.values, gaussians.nodes, poses.positions, poses.quats, rows)
            return Splats(*vars(placed).values())
        return self.place_population(gaussians.population(rows, self.nodes), poses, stamps)

    def place_population(self, some: Population, poses: Poses, stamps: list[int]) -> Splats:
        """The same of Gaussians that need not be those stored."""
        bends = bool((some.tiers == int(Tier.DEFORMABLE)).any())
        if not bends and not torch.is_grad_enabled() and splat.has_kernels(some.values.device):
            placed = splat.place(some.values, some.carriers, poses.positions, poses.quats)
            return Splats(*vars(placed).values())
        return self.place_reference(some, poses, stamps)

    def place_reference(self, some: Population, poses: Poses, stamps: list[int]) -> Splats:
        """The same in torch, on any device: the reference of the compiled library, with gradients and the field."""
        times, values = len(stamps), some.values
        means, quats = values[:, MEAN].expand(times, -1, -1), values[:, QUAT].expand(times, -1, -1)
        carried = torch.nonzero(some.carriers >= 0)[:, 0]
        if len(carried):
            own = Population(values[carried], some.tiers[carried], some.carriers[carried], some.anchors)
            carriage, bend = carry(poses, own.carriers), self.bend(own, stamps)
            if bend is not None:
                carriage = carriage.bent(bend)
            means = means.index_copy(1, carried, carriage.means(own.values[:, MEAN]))
            quats = quats.index_copy(1, carried, carriage.quats(own.values[:, QUAT]))
        return activated(values, means, quats)

    def bend(self, some: Population, stamps: list[int]) -> Bend | None:
        """What the field does to the DEFORMABLE among `some`; None without one."""
        chosen = torch.nonzero(some.tiers == int(Tier.DEFORMABLE))[:, 0]
        if not len(chosen):
            return None
        means = some.values[chosen, MEAN]
        anchors = some.anchors[some.carriers[chosen].cpu()].to(means)
        residual = self.field.residual(means + anchors, stamps)
        return Bend(chosen, residual.offsets, quat_from_vector(residual.rotations))

    def slide(self, stamp: int) -> None:
        """The window now ends at `stamp` (ns)."""
        if not self.field.stamps or stamp > self.field.stamps[-1]:
            self.field.slide(stamp)

    def descend(self) -> None:
        """One step on the field by the gradients that it holds; taken only where all of them are finite."""
        gradients = [p.grad for p in self.field.parameters() if p.grad is not None]
        if gradients and all(bool(torch.isfinite(g).all()) for g in gradients):
            self._adam.step()
        self._adam.forget_gradients()
