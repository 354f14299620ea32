"""The field of 4DGS: six planes per resolution (Cao and Johnson, CVPR 2023), multiplied, and small heads."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from twin_node.model.sequence.field import Box, MotionHeads, SequenceMotion

SPACE_AXES, TIME_AXES = ((0, 1), (0, 2), (1, 2)), (0, 1, 2)
"""Coordinates that the planes xy, xz, yz are sampled at, and those that the time planes pair with time."""


@dataclass(frozen=True)
class HexPlaneParameters:
    """Sizes and weights of a `SequenceHexPlane`, as published for multi-view video."""

    resolution: int = 64
    """Cells of a plane along each axis of the box, at the coarsest level."""
    columns: int = 0
    """Columns of a time plane; 0: half the time steps of the sequence, as published (150 for 300)."""
    features: int = 16
    """Channels of a plane."""
    levels: tuple[int, ...] = (1, 2)
    """Multiples of `resolution`; time planes keep their columns."""
    hidden: int = 64
    """Width of the heads."""
    variation: float = 2e-4
    """Weight of the planes' second differences in space."""
    bend: float = 1e-3
    """Weight of the time planes' second differences in time."""
    change: float = 1e-4
    """Weight of the time planes' distance from 1, which stands for no motion."""


class Planes(nn.Module):
    """Features of space and time: product over six planes, concatenated over resolutions."""

    def __init__(
        self, resolution: int, columns: int, features: int, levels: tuple[int, ...], generator: torch.Generator
    ) -> None:
        super().__init__()
        self.width = features * len(levels)
        """Features that a point has."""
        sizes = [resolution * level for level in levels]
        self.space = nn.ParameterList(
            nn.Parameter(torch.empty(3, features, size, size).uniform_(0.1, 0.5, generator=generator)) for size in sizes
        )
        self.time = nn.ParameterList(nn.Parameter(torch.ones(3, features, columns, size)) for size in sizes)

    def forward(self, unit: Tensor, times: Tensor) -> Tensor:
        """Features [T, N, width] of points [N, 3] at times [T, N], all in -1 to 1."""
        flat = torch.stack([unit[:, list(axes)] for axes in SPACE_AXES])[:, None]
        rows = torch.stack([torch.stack([unit[:, axis].expand_as(times), times], -1) for axis in TIME_AXES])
        levels = []
        for space, time in zip(self.space, self.time, strict=True):
            still = _sample(space, flat).prod(0)[:, 0].T
            levels.append(still * _sample(time, rows).prod(0).permute(1, 2, 0))
        return torch.cat(levels, -1)

    def variation(self) -> Tensor:
        """Mean squared second differences in space of three planes of a kind, summed over kinds, axes, resolutions."""
        both = [*self.space, *self.time]
        return torch.stack([_bend(plane, -1) for plane in both] + [_bend(plane, -2) for plane in self.space]).sum()

    def bend(self) -> Tensor:
        """Mean squared second differences of the time planes in time, summed over resolutions."""
        return torch.stack([_bend(plane, -2) for plane in self.time]).sum()

    def change(self) -> Tensor:
        """Mean distance of the time planes from 1, summed over resolutions."""
        return torch.stack([(plane - 1).abs().mean() for plane in self.time]).sum()


class SequenceHexPlane(nn.Module):
    """A `SequenceField` of planes; identity at the start, as the last layers of its heads are zero."""

    def __init__(self, box: Box, steps: int, parameters: HexPlaneParameters | None = None, seed: int = 0) -> None:
        """`steps`: time steps of the sequence. Raises `ValueError` for fewer than one."""
        super().__init__()
        if steps < 1:
            raise ValueError(f"SequenceHexPlane: expected one time step or more, found {steps}")
        self.box = box
        self.sizes = sizes = parameters or HexPlaneParameters()
        generator = torch.Generator().manual_seed(seed)
        columns = max(sizes.columns or (steps + 1) // 2, 2)
        self.planes = Planes(sizes.resolution, columns, sizes.features, sizes.levels, generator)
        self.heads = MotionHeads(self.planes.width, sizes.hidden, box.reach, generator)

    @property
    def parameters_count(self) -> int:
        """Learned numbers: planes and heads."""
        return sum(p.numel() for p in self.parameters())

    def grids(self) -> list[nn.Parameter]:
        """The planes."""
        return list(self.planes.parameters())

    def decoder(self) -> list[nn.Parameter]:
        """The heads."""
        return list(self.heads.parameters())

    def motion(self, points: Tensor, times: Tensor) -> SequenceMotion:
        """Motion of canonical points [N, 3] (m) at times [T] (-1 to 1 over the sequence)."""
        features = self.planes(self.box.unit(points), times[:, None].expand(-1, len(points)))
        motion: SequenceMotion = self.heads(features)
        return motion

    def regularity(self, random: torch.Generator) -> Tensor:
        """Second differences in space and time, and the pull of the time planes to 1 (Wu et al., CVPR 2024)."""
        del random  # all of every plane is looked at
        sizes = self.sizes
        smooth = sizes.variation * self.planes.variation() + sizes.bend * self.planes.bend()
        return smooth + sizes.change * self.planes.change()


def _sample(planes: Tensor, places: Tensor) -> Tensor:
    """[3, features, ...] of planes [3, features, H, W] at places [3, ..., 2] in -1 to 1; both ends are inside."""
    return F.grid_sample(planes, places, align_corners=True, padding_mode="border")


def _bend(plane: Tensor, dim: int) -> Tensor:
    if plane.shape[dim] < 3:
        return plane.new_zeros(())
    return plane.diff(n=2, dim=dim).square().mean()
