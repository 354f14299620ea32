"""A scene over a whole sequence: canonical Gaussians and the field that moves them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.parameters import ModelError
from twin_node.model.sequence.canonical import CanonicalGaussians
from twin_node.model.sequence.field import SequenceField, moved_quats
from twin_node.scene import Camera, Float32

LARGEST_M = 1e12
"""What is larger is drawn as large, m: of no scene that float32 tells places apart in would it show anything else."""


@dataclass(frozen=True)
class Span:
    """The times that a sequence model knows."""

    first: int
    """ns."""
    last: int
    """ns."""

    def evenly(self, count: int) -> list[int]:
        """At most `count` stamps, ns, from the first to the last; the first alone for one."""
        length = self.last - self.first
        return sorted({self.first + round(length * index / max(count - 1, 1)) for index in range(count)})

    def times(self, stamps: Sequence[int]) -> Tensor:
        """[T] stamps (ns) as -1 to 1, clamped: a field knows nothing outside. All 0 where the span is one instant."""
        length = self.last - self.first
        shares = [(stamp - self.first) / length if length else 0.5 for stamp in stamps]
        return (2 * torch.tensor(shares, dtype=torch.float64) - 1).clamp(-1, 1).float()


@dataclass(frozen=True)
class MovedGaussians:
    """Gaussians at T times, ready to be drawn."""

    means: Tensor
    """[T, N, 3] m."""
    quats: Tensor
    """[T, N, 4] w, x, y, z."""
    scales: Tensor
    """[T, N, 3] m."""
    opacities: Tensor
    """[N] 0 to 1."""
    sh: Tensor
    """[N, K, 3] harmonic coefficients."""

    def detached(self) -> MovedGaussians:
        """The same numbers, cut off from what they were computed with."""
        return MovedGaussians(*(value.detach() for value in vars(self).values()))


@dataclass(frozen=True)
class Drawn:
    """One image with what training needs to know of it."""

    rgb: Tensor
    """[H, W, 3], 0 to 1 where the model fits."""
    radii: Tensor
    """[N, 2] half sizes in pixels; 0 where not drawn."""


@dataclass
class SequenceModel:
    """Gaussians, field and span; what `train` makes and `bake` evaluates."""

    gaussians: CanonicalGaussians
    field: SequenceField | None
    """None: nothing moves."""
    span: Span
    background: tuple[float, float, float]
    """Red, green, blue, 0 to 1, where nothing is."""
    homes: Tensor | None = None
    """[N, 3] m, where the field is asked for each Gaussian's motion, of a model in which some were moved by hand; None:
    where they are."""

    @property
    def parameters_count(self) -> int:
        """Learned numbers."""
        return self.gaussians.parameters_count + (self.field.parameters_count if self.field else 0)

    def at(self, stamps: Sequence[int], moving: bool = True) -> MovedGaussians:
        """Gaussians at stamps (ns), without the field unless `moving`. Raises `ModelError` without stamps."""
        if not stamps:
            raise ModelError("sequence: expected one stamp or more, found none")
        g = self.gaussians
        log_scales, opacities = g.log_scales.expand(len(stamps), -1, -1), g.logits.sigmoid()
        if self.field is None or not moving:
            means, quats = g.means.expand(len(stamps), -1, -1), g.quats.expand(len(stamps), -1, -1)
            unit = torch.nn.functional.normalize(quats, dim=-1)
            return MovedGaussians(means, unit, _scales(log_scales), opacities, g.sh)
        homes = g.means if self.homes is None else self.homes
        motion = self.field.motion(homes, self.span.times(stamps).to(g.means.device))
        quats = moved_quats(g.quats, motion.turns)
        scales = _scales(log_scales + motion.growths)
        return MovedGaussians(g.means + motion.offsets, quats, scales, opacities, g.sh)

    def render(self, camera: Camera, stamp: int) -> Float32:
        """[H, W, 3] 0 to 1: what `camera` sees at `stamp` (ns)."""
        with torch.no_grad():
            rgb = draw(self.at([stamp]), 0, camera, self.background).rgb
        image: Float32 = rgb.clamp(0, 1).cpu().numpy()
        return image


def _scales(log_scales: Tensor) -> Tensor:
    """Scales [..., 3], m, of their logarithms, which a long training may carry to where float32 ends."""
    return log_scales.clamp_max(math.log(LARGEST_M)).exp()


def draw(
    moved: MovedGaussians, time: int, camera: Camera, background: Sequence[float], means: Tensor | None = None
) -> Drawn:
    """The image of `camera` at the time of row `time`; `means` [N, 3] in place of its own, for their gradient."""
    placed = moved.means[time] if means is None else means

    def tensor(values: object) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=placed.device)[None]

    renders, _, meta = splat.rasterize(
        placed,
        moved.quats[time],
        moved.scales[time],
        moved.opacities,
        moved.sh,
        tensor(camera.viewmat),
        tensor(camera.K),
        camera.width,
        camera.height,
        sh_degree=math.isqrt(moved.sh.shape[1]) - 1,
        backgrounds=tensor(background),
    )
    return Drawn(renders[0], meta.radii[0])
