"""Deformation fields: what a Gaussian does in the window beyond the motion of its node."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

_SPACE_AXES = ((0, 1), (0, 2), (1, 2))
"""Coordinates that the planes xy, xz, yz are sampled at."""


@dataclass(frozen=True)
class FieldParameters:
    """Size of a deformation field; from 4DGS and K-Planes, scaled to a window and a node."""

    resolution: int = 32
    """Cells of a plane along each axis of the box."""
    features: int = 16
    """Channels of a plane."""
    hidden: int = 32
    """Width of the decoder's one hidden layer."""


@dataclass(frozen=True)
class Deformation:
    """Residual motion at T times."""

    offsets: Tensor
    """[T, N, 3] m, added to the means."""
    rotations: Tensor
    """[T, N, 3] rotation vectors, rad, applied before the node's rotation."""


class HexPlane(nn.Module):
    """Six planes and a small decoder (Cao and Johnson, CVPR 2023; Wu et al., CVPR 2024), in residual form.

    The residual is `D(f_s * f_t) - D(f_s)`, with space features f_s (product of the planes xy, xz, yz), time features
    f_t (product of xt, yt, zt) and decoder D: exactly zero where the time planes are 1, whatever the decoder has
    learned. Time columns form a ring, so that a slide touches one column and the decoder is inherited.
    """

    def __init__(
        self, lower: Tensor, upper: Tensor, columns: int, parameters: FieldParameters | None = None, seed: int = 0
    ) -> None:
        """`lower`, `upper` [3] m: the box that canonical points lie in; `columns`: length of the window.

        Raises `ValueError` for an empty box or fewer than two columns.
        """
        super().__init__()
        if not bool((upper > lower).all()) or columns < 2:
            raise ValueError(
                f"HexPlane: expected lower < upper and 2 columns or more, found {lower}, {upper}, {columns}"
            )
        self.sizes = parameters or FieldParameters()
        size, features = self.sizes.resolution, self.sizes.features
        generator = torch.Generator().manual_seed(seed)
        self.lower, self.upper = lower.float(), upper.float()
        space = torch.empty(3, features, size, size).uniform_(0.1, 0.5, generator=generator)
        self.space = nn.Parameter(space.to(lower.device))
        self.time = nn.Parameter(torch.ones(3, features, columns, size, device=lower.device))
        self.hidden = nn.Parameter(_uniform(generator, self.sizes.hidden, features).to(lower.device))
        self.hidden_bias = nn.Parameter(torch.zeros(self.sizes.hidden, device=lower.device))
        self.out = nn.Parameter(_uniform(generator, 6, self.sizes.hidden).to(lower.device))
        self.stamps: list[int] = []
        """Stamps of the columns in use, oldest first, ns."""
        self._slots: list[int] = []

    @property
    def parameters_count(self) -> int:
        """Learned numbers: planes and decoder."""
        return sum(p.numel() for p in self.parameters())

    def slide(self, stamp: int) -> None:
        """Add a column for a newer stamp (ns), equal to the newest; the oldest column makes room.

        Raises `ValueError` for a stamp that is not newer than the newest.
        """
        if self.stamps and stamp <= self.stamps[-1]:
            raise ValueError(f"HexPlane.slide: expected a stamp after {self.stamps[-1]} ns, found {stamp} ns")
        columns = self.time.shape[2]
        slot = len(self._slots) if len(self._slots) < columns else self._slots.pop(0)
        if len(self.stamps) == columns:
            self.stamps.pop(0)
        with torch.no_grad():
            if self._slots:
                self.time[:, :, slot] = self.time[:, :, self._slots[-1]]
        self._slots.append(slot)
        self.stamps.append(stamp)

    def residual(self, points: Tensor, stamps: list[int]) -> Deformation:
        """Deformation of canonical points [N, 3] (m) at stamps (ns), clamped to the window's ends and the box."""
        unit = (2 * (points - self.lower) / (self.upper - self.lower) - 1).clamp(-1, 1)
        planes = torch.stack([unit[:, list(axes)] for axes in _SPACE_AXES])[:, None]
        space = F.grid_sample(self.space, planes, align_corners=True).prod(0)[:, 0].T
        still = self._decode(space)
        lines = torch.stack([torch.stack([unit[:, i], torch.zeros_like(unit[:, i])], -1) for i in range(3)])[:, None]
        moved = {}
        for stamp in dict.fromkeys(stamps):
            column = self._column(stamp)[:, :, None]
            time = F.grid_sample(column, lines, align_corners=True).prod(0)[:, 0].T
            moved[stamp] = self._decode(space * time) - still
        both = torch.stack([moved[stamp] for stamp in stamps])
        return Deformation(both[..., :3], both[..., 3:])

    def regularity(self) -> Tensor:
        """Plane regulariser: total variation in space, second differences in time, pull of the time planes to 1."""
        variation = (self.space.diff(dim=-1) ** 2).mean() + (self.space.diff(dim=-2) ** 2).mean()
        window = self.time[:, :, self._slots]
        bend = (window.diff(n=2, dim=2) ** 2).mean() if len(self._slots) > 2 else window.new_zeros(())
        return variation + bend + 0.1 * (window - 1).abs().mean()

    def _column(self, stamp: int) -> Tensor:
        """[3, features, resolution] the time planes at a stamp, linear between columns."""
        after = next((i for i, known in enumerate(self.stamps) if known >= stamp), len(self.stamps) - 1)
        before = max(after - 1, 0)
        if stamp >= self.stamps[after] or stamp <= self.stamps[before]:
            nearest = after if stamp >= self.stamps[after] else before
            return self.time[:, :, self._slots[nearest]]
        share = (stamp - self.stamps[before]) / (self.stamps[after] - self.stamps[before])
        return torch.lerp(self.time[:, :, self._slots[before]], self.time[:, :, self._slots[after]], share)

    def _decode(self, features: Tensor) -> Tensor:
        """[N, 6] offset and rotation of features [N, features]."""
        return F.linear(F.relu(F.linear(features, self.hidden, self.hidden_bias)), self.out)


def _uniform(generator: torch.Generator, rows: int, columns: int) -> Tensor:
    """Weights of a linear layer: uniform within 1 / sqrt(inputs), torch's own default."""
    bound = columns**-0.5
    return torch.empty(rows, columns).uniform_(-bound, bound, generator=generator)
