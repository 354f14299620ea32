"""What is asked of gradient steps on some Gaussians of a scene that others stand in, and what comes of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from twin_node.splat.adam import Decays
from twin_node.splat.arguments import Options, require_layout
from twin_node.splat.columns import WIDTH

OPTIONS = Options(render_mode="RGB+D")
"""How all is drawn."""


@dataclass(frozen=True)
class Learners:
    """n of a store of N Gaussians that learn; values, moments and steps are brought up to date in place."""

    rows: Tensor
    """[n] int64, each once."""
    values: Tensor
    """[N, 14] in the frames of what carries them: mean, quaternion w x y z, log scale, opacity logit, colour."""
    moment1: Tensor
    """[N, 14] Adam's."""
    moment2: Tensor
    """[N, 14]."""
    steps: Tensor
    """[N] int64 steps taken."""
    ceilings: Tensor
    """[N] largest log scale."""
    rates: Tensor
    """[n, 14]."""
    turns: Tensor
    """[T, K, 3, 3] what means are turned by, for each camera and each of K carriers."""
    shifts: Tensor
    """[T, K, 3] what is then added to them."""
    products: Tensor
    """[T, K, 4, 4] what quaternions are multiplied by."""
    carriers: Tensor
    """[n] int64 which of the K carries each."""


@dataclass(frozen=True)
class Bystanders:
    """m Gaussians that are drawn and do not learn, as `rasterize` takes them, at each of T times."""

    means: Tensor
    """[T, m, 3]."""
    quats: Tensor
    """[T, m, 4]."""
    scales: Tensor
    """[m, 3]."""
    opacities: Tensor
    """[m]."""
    colors: Tensor
    """[m, 3]."""


@dataclass(frozen=True)
class Aims:
    """T cameras, each at a time of its own, and what they should see."""

    viewmats: Tensor
    """[T, 4, 4]."""
    Ks: Tensor
    """[T, 3, 3] pixels."""
    backdrop: Tensor
    """[T, H, W, 4] colour and depth of what stands behind all that is drawn."""
    pixel_mask: Tensor | None
    """[T, H, W] bool: pixels that are drawn."""
    rgb: Tensor
    """[T, H, W, 3] 0 to 1."""
    weights: Tensor | None
    """[T, H, W]."""
    depth: Tensor | None
    """[T, H, W], 0 where unknown."""
    depth_weight: float


@dataclass(frozen=True)
class Descended:
    """What the last step saw and did."""

    seen: Tensor
    """[T, H, W, 4] colour and depth before it, the backdrop behind."""
    alphas: Tensor
    """[T, H, W] of what is drawn."""
    v_means: Tensor
    """[T, n, 3] gradient by the learners' carried means."""
    v_quats: Tensor
    """[T, n, 4]."""
    refused: int
    """Steps of single Gaussians that were not finite and not taken."""
    losses: Tensor
    """[steps] float64, before each of them."""


@dataclass(frozen=True)
class Course:
    """How steps are taken."""

    steps: int
    """1 or more."""
    smallest_log_scale: float
    decays: Decays = field(default_factory=Decays)


def require_layouts(learners: Learners, bystanders: Bystanders, aims: Aims) -> None:
    """Raises `ValueError` naming what is of another shape or kind or, of what is brought up to date, in pieces."""
    count, learned, (times, carriages) = len(learners.values), len(learners.rows), (*learners.turns.shape, 0, 0)[:2]
    kept = {"values": (count, WIDTH), "moment1": (count, WIDTH), "moment2": (count, WIDTH), "steps": (count,)}
    size = (times, *aims.rgb.shape[1:3])
    learns = {"ceilings": (count,), "rates": (learned, WIDTH), "rows": (learned,), "carriers": (learned,)}
    carried = {"turns": (times, carriages, 3, 3), "shifts": (times, carriages, 3), "products": (times, carriages, 4, 4)}
    seen = {"backdrop": (*size, 4), "pixel_mask": size, "rgb": (*size, 3), "weights": size, "depth": size}
    cameras = {"viewmats": (times, 4, 4), "Ks": (times, 3, 3)}
    m = (*bystanders.means.shape, 0, 0)[1]
    stands = {"means": (times, m, 3), "quats": (times, m, 4), "scales": (m, 3), "opacities": (m,), "colors": (m, 3)}
    given = ((learners, {**kept, **learns, **carried}), (bystanders, stands), (aims, {**seen, **cameras}))
    for of, shapes in given:
        for name, shape in shapes.items():
            require_layout(name, vars(of)[name], shape, _KINDS.get(name, torch.float32), learners.values.device)
    for name in kept:
        if not vars(learners)[name].is_contiguous():
            raise ValueError(f"{name}: expected rows that lie one after the other, found others; give a copy")


_KINDS = dict.fromkeys(("rows", "steps", "carriers"), torch.int64) | {"pixel_mask": torch.bool}
