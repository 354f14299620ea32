"""Deformation fields over a whole sequence, in the published form of 4DGS (Wu et al., CVPR 2024)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn

from twin_node.model.parameters import ModelError
from twin_node.model.rotations import quat_product


@dataclass(frozen=True)
class SequenceMotion:
    """What a field adds to N canonical Gaussians at T times."""

    offsets: Tensor
    """[T, N, 3] m, added to the means."""
    turns: Tensor
    """[T, N, 4] w, x, y, z, about 1: the canonical quaternions are multiplied by them from the right."""
    growths: Tensor
    """[T, N, 3] added to the log scales."""


@dataclass(frozen=True)
class Box:
    """The space and time that a field spans; outside it is clamped. Raises `ModelError` for sides of no length."""

    lower: Tensor
    """[3] m."""
    upper: Tensor
    """[3] m."""

    def __post_init__(self) -> None:
        if not bool((self.upper > self.lower).all()):
            raise ModelError(
                f"box: expected sides above 0 in float32, found {self.lower.tolist()} to {self.upper.tolist()} m; "
                "move the scene to the origin"
            )

    def unit(self, points: Tensor) -> Tensor:
        """Points [..., 3] in m as -1 to 1."""
        return (2 * (points - self.lower) / (self.upper - self.lower) - 1).clamp(-1, 1)

    def to(self, device: torch.device) -> Box:
        """The same box on a device."""
        return Box(self.lower.to(device), self.upper.to(device))

    @property
    def reach(self) -> float:
        """Half the longest side, m: the unit that the decoder speaks in, so that rates do not depend on the scene."""
        return float((self.upper - self.lower).amax()) / 2


class SequenceField(Protocol):
    """A learned motion of canonical points over a sequence: nothing at all before training."""

    @property
    def parameters_count(self) -> int:
        """Learned numbers."""

    def parameters(self) -> Iterator[nn.Parameter]:
        """What an optimiser may change."""

    def grids(self) -> list[nn.Parameter]:
        """Those among them that are looked up rather than multiplied by: they take the higher rate."""

    def decoder(self) -> list[nn.Parameter]:
        """The others."""

    def motion(self, points: Tensor, times: Tensor) -> SequenceMotion:
        """Motion of canonical points [N, 3] (m) at times [T] (-1 to 1 over the sequence)."""

    def regularity(self, random: torch.Generator) -> Tensor:
        """What smooth motion keeps small, weighted: added to the loss; `random` draws where to look."""


class MotionHeads(nn.Module):
    """Features to motion: one hidden layer each for offset, turn and growth; the last layers start at zero."""

    def __init__(self, features: int, hidden: int, reach: float, generator: torch.Generator) -> None:
        super().__init__()
        self.reach = reach
        self.trunk = linear(features, hidden, generator)
        self.inner = nn.ModuleList(linear(hidden, hidden, generator) for _ in range(3))
        self.outer = nn.ModuleList(_silent(hidden, out) for out in (3, 4, 3))

    def forward(self, features: Tensor) -> SequenceMotion:
        """[T, N, features] to the motion of N points at T times."""
        trunk = torch.relu(self.trunk(features))
        offset, turn, growth = (
            outer(torch.relu(inner(trunk))) for inner, outer in zip(self.inner, self.outer, strict=True)
        )
        identity = turn.new_tensor([1.0, 0.0, 0.0, 0.0])
        return SequenceMotion(self.reach * offset, identity + turn, growth)


def moved_quats(quats: Tensor, turns: Tensor) -> Tensor:
    """Canonical quaternions [N, 4] turned [T, N, 4]; of length 1."""
    turned = quat_product(quats.expand_as(turns), turns)
    unit: Tensor = nn.functional.normalize(turned, dim=-1)
    return unit


def linear(inputs: int, outputs: int, generator: torch.Generator) -> nn.Linear:
    """Uniform within 1 / sqrt(inputs), torch's own default, from a generator; no bias at the start."""
    layer = nn.Linear(inputs, outputs)
    with torch.no_grad():
        layer.weight.uniform_(-(inputs**-0.5), inputs**-0.5, generator=generator)
        layer.bias.zero_()
    return layer


def _silent(inputs: int, outputs: int) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    with torch.no_grad():
        layer.weight.zero_()
        layer.bias.zero_()
    return layer
