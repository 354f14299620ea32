"""Gaussians carried from the frames of their nodes to `base_link`, and gradients carried back: linear both ways."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.model.kernels import kernels
from twin_node.model.node_requests import CarryRequest
from twin_node.model.nodes import Poses
from twin_node.model.rotations import left_product, rotation_matrix


@dataclass(frozen=True)
class Bend:
    """What the field adds to those of n Gaussians that it bends, in the nodes' frames at each of T times."""

    chosen: Tensor
    """[c] which of the n."""
    offsets: Tensor
    """[T, c, 3] m, added to the means."""
    turns: Tensor
    """[T, c, 4] rotations that the quaternions are multiplied by from the left."""


@dataclass(frozen=True)
class Carriage:
    """What the poses of K nodes do to n Gaussians at each of T times."""

    turns: Tensor
    """[T, K, 3, 3] rotation of the node."""
    shifts: Tensor
    """[T, K, 3] m, position of the node."""
    products: Tensor
    """[T, K, 4, 4] the quaternion product with the node's rotation."""
    carriers: Tensor
    """[n] int64: which of the K carries each."""

    def bent(self, bend: Bend) -> Carriage:
        """The same with `bend` before it: each Gaussian is then carried by one of its own."""
        turns, shifts, products = (of.index_select(1, self.carriers) for of in (self.turns, self.shifts, self.products))
        offsets = _apply(turns[:, bend.chosen], bend.offsets)
        bent = products[:, bend.chosen] @ left_product(bend.turns)
        return Carriage(
            turns,
            shifts.index_add(1, bend.chosen, offsets),
            products.index_copy(1, bend.chosen, bent),
            torch.arange(len(self.carriers), device=self.carriers.device),
        )

    def means(self, local: Tensor) -> Tensor:
        """[T, n, 3] m in `base_link` of means [n, 3] or [T, n, 3] in the nodes' frames."""
        return _apply(self._of(self.turns), local) + self._of(self.shifts)

    def quats(self, local: Tensor) -> Tensor:
        """[T, n, 4] in `base_link` of quaternions [n, 4] or [T, n, 4] in the nodes' frames."""
        return _apply(self._of(self.products), local)

    def means_gradient(self, gradient: Tensor) -> Tensor:
        """[T, n, 3] gradient with respect to what `means` was given, from that [T, n, 3] with respect to its result."""
        return _apply(self._of(self.turns).transpose(-1, -2), gradient)

    def quats_gradient(self, gradient: Tensor) -> Tensor:
        """[T, n, 4] gradient with respect to what `quats` was given, from that [T, n, 4] with respect to its result."""
        return _apply(self._of(self.products).transpose(-1, -2), gradient)

    def _of(self, per_node: Tensor) -> Tensor:
        """[T, n, ...] for each Gaussian, of [T, K, ...]."""
        return per_node.index_select(1, self.carriers)


def carry(poses: Poses, carriers: Tensor) -> Carriage:
    """The carriage of Gaussians whose nodes are `carriers` [n]; -1 stands still in `base_link`."""
    library = kernels()
    if library is None or poses.positions.device.type != "cpu":
        return carry_reference(poses, carriers)
    times, nodes = poses.positions.shape[:2]
    shapes = ((3, 3), (3,), (4, 4))
    sizes = [times * (nodes + 1) * math.prod(shape) for shape in shapes]
    found = torch.empty(sum(sizes))
    held = (poses.positions.contiguous(), poses.quats.contiguous(), *torch.split(found, sizes))
    library.run(CarryRequest(times, nodes, *(t.data_ptr() for t in held)))
    there = torch.split(found.to(carriers.device), sizes)  # found there, they would be dozens of small kernels
    turns, shifts, products = (of.view(times, nodes + 1, *shape) for of, shape in zip(there, shapes, strict=True))
    return Carriage(turns, shifts, products, carriers.remainder(nodes + 1))  # -1 is the row at rest


def carry_reference(poses: Poses, carriers: Tensor) -> Carriage:
    """The same in torch: the reference of the compiled kernel."""
    times = poses.positions.shape[0]
    rest = poses.quats.new_tensor([1.0, 0, 0, 0]).expand(times, 1, 4)
    quats = torch.cat([poses.quats, rest], 1).to(carriers.device)
    positions = torch.cat([poses.positions, poses.positions.new_zeros(times, 1, 3)], 1).to(carriers.device)
    return Carriage(
        rotation_matrix(quats).float(),
        positions.float(),
        left_product(quats).float(),
        carriers.remainder(quats.shape[1]),  # -1 is the row at rest
    )


def _apply(matrices: Tensor, vectors: Tensor) -> Tensor:
    """Matrices [T, n, k, k] times vectors [n, k] or [T, n, k], by columns: batched products of this size crawl."""
    out = matrices[..., 0] * vectors[..., :1]
    for column in range(1, matrices.shape[-1]):
        out = torch.addcmul(out, matrices[..., column], vectors[..., column, None])
    return out
