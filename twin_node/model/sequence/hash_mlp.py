"""A field on a multi-resolution hash grid over space and time (Mueller et al., TOG 2022), with the same small heads."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from twin_node.model.parameters import ModelError
from twin_node.model.sequence.field import Box, MotionHeads, SequenceMotion
from twin_node.ranges import Range, check_ranges

PRIMES = (1, 2654435761, 805459861, 3674653429)
"""Factors of the spatial hash; the first three of Mueller et al., one more prime for time."""
PROBES = 512
"""Random points and times at which `regularity` looks at the motion's bend."""


@dataclass(frozen=True)
class HashParameters:
    """Sizes and weights of a `SequenceHashMlp`: 3DGStream's grid with a fourth axis."""

    levels: int = 8
    """Resolutions."""
    features: int = 4
    """Numbers per entry."""
    log2_entries: int = 15
    """Entries of a level's table, as a power of two."""
    coarsest: int = 8
    """Cells along each axis of the box at the first level."""
    finest: int = 128
    """Cells at the last."""
    columns: int = 0
    """Cells in time at the last level; 0: half the time steps of the sequence."""
    hidden: int = 64
    """Width of the heads."""
    bend: float = 1e-2
    """Weight of the motion's second difference in time, in units of the box."""

    def __post_init__(self) -> None:
        """Raises `ModelError` for more levels or entries than anybody can make."""
        check_ranges(self, ModelError, "hash: ", levels=Range(1, 32), log2_entries=Range(1, 32))


class HashGrid(nn.Module):
    """Features of points in 2 to 4 dimensions: linear between hashed corners, concatenated over resolutions."""

    def __init__(
        self, resolutions: tuple[tuple[int, ...], ...], features: int, entries: int, generator: torch.Generator
    ) -> None:
        """`resolutions`: cells along each axis, per level; `entries` per level, a power of two."""
        super().__init__()
        self.width = features * len(resolutions)
        """Features that a point has."""
        table = torch.empty(len(resolutions), entries, features).uniform_(-1e-4, 1e-4, generator=generator)
        self.table = nn.Parameter(table)
        self.register_buffer("_cells", torch.tensor(resolutions, dtype=torch.float32), persistent=False)

    def forward(self, unit: Tensor) -> Tensor:
        """Features [n, width] of points [n, axes] in -1 to 1."""
        entries, features = self.table.shape[1:]
        cells = torch.as_tensor(self._cells)
        place = (unit[:, None] + 1) / 2 * cells
        low = torch.minimum(place.floor(), cells - 1)
        share, first = place - low, low.long()
        weights, row = share.new_ones(*share.shape[:2], 1), first.new_zeros(*share.shape[:2], 1)
        for axis, prime in enumerate(PRIMES[: unit.shape[1]]):
            both = torch.stack([1 - share[..., axis], share[..., axis]], -1)
            hashed = torch.stack([first[..., axis], first[..., axis] + 1], -1) * prime
            weights = (weights[..., None] * both[..., None, :]).flatten(2)
            row = (row[..., None] ^ hashed[..., None, :]).flatten(2)
        row = (row & (entries - 1)) + torch.arange(len(cells), device=unit.device)[:, None] * entries
        corners = row.shape[-1]
        looked_up = self.table.view(-1, features).index_select(0, row.flatten()).view(-1, corners, features)
        return torch.bmm(weights.view(-1, 1, corners), looked_up).view(len(unit), -1)


class SequenceHashMlp(nn.Module):
    """A `SequenceField` on a hash grid over x, y, z and time; identity at the start."""

    def __init__(self, box: Box, steps: int, parameters: HashParameters | None = None, seed: int = 0) -> None:
        """`steps`: time steps of the sequence. Raises `ValueError` for fewer than one."""
        super().__init__()
        if steps < 1:
            raise ValueError(f"SequenceHashMlp: expected one time step or more, found {steps}")
        self.box = box
        self.steps = steps
        self.sizes = sizes = parameters or HashParameters()
        generator = torch.Generator().manual_seed(seed)
        columns = max(sizes.columns or (steps + 1) // 2, 1)
        space = _geometric(sizes.coarsest, sizes.finest, sizes.levels)
        time = _geometric(min(2, columns), columns, sizes.levels)
        resolutions = tuple((cells, cells, cells, column) for cells, column in zip(space, time, strict=True))
        self.grid = HashGrid(resolutions, sizes.features, 2**sizes.log2_entries, generator)
        self.heads = MotionHeads(self.grid.width, sizes.hidden, box.reach, generator)

    @property
    def parameters_count(self) -> int:
        """Learned numbers: table and heads."""
        return sum(p.numel() for p in self.parameters())

    def grids(self) -> list[nn.Parameter]:
        """The table."""
        return [self.grid.table]

    def decoder(self) -> list[nn.Parameter]:
        """The heads."""
        return list(self.heads.parameters())

    def motion(self, points: Tensor, times: Tensor) -> SequenceMotion:
        """Motion of canonical points [N, 3] (m) at times [T] (-1 to 1 over the sequence).

        Sends no gradient back to the points: across hashed cells it would be noise, and take half of the time.
        """
        at = times[:, None].expand(-1, len(points))
        return self._motion(self.box.unit(points.detach()).expand(len(times), -1, -1), at)

    def regularity(self, random: torch.Generator) -> Tensor:
        """Mean squared second difference of the offsets in time, one time step apart, at random points of the box."""
        if self.steps < 3:
            return self.grid.table.new_zeros(())
        device = self.grid.table.device
        unit = (2 * torch.rand(PROBES, 3, generator=random) - 1).to(device)
        step = 2 / (self.steps - 1)
        middle = ((2 - 2 * step) * torch.rand(PROBES, generator=random) - 1 + step).to(device)
        at = torch.stack([middle - step, middle, middle + step])
        offsets = self._motion(unit.expand(3, -1, -1), at).offsets / self.box.reach
        return self.sizes.bend * offsets.diff(n=2, dim=0).square().mean()

    def _motion(self, unit: Tensor, times: Tensor) -> SequenceMotion:
        """Motion at places [T, N, 3] and times [T, N]."""
        both = torch.cat([unit, times[..., None]], -1)
        features = self.grid(both.reshape(-1, 4)).view(*both.shape[:2], -1)
        motion: SequenceMotion = self.heads(features)
        return motion


def _geometric(first: int, last: int, count: int) -> list[int]:
    """Whole numbers from `first` to `last`, each larger than the one before by the same factor."""
    growth = math.log(last / first) / max(count - 1, 1)
    return [round(first * math.exp(growth * level)) for level in range(count)]
