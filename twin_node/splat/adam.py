"""One step of Adam for rows of which some may not be pulled at: in torch, on any device, without waiting for it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.splat.columns import LOG_SCALE, RGB


@dataclass(frozen=True)
class Decays:
    """What Adam's moments keep of themselves per step, 0 to 1 (Kingma and Ba, 2015)."""

    first: float = 0.9
    second: float = 0.99


@dataclass(frozen=True)
class AdamState:
    """n rows that learn."""

    values: Tensor
    """[n, 14] see `Learners.values`."""
    moment1: Tensor
    """[n, 14]."""
    moment2: Tensor
    """[n, 14]."""
    steps: Tensor
    """[n] int64 steps taken."""


@dataclass(frozen=True)
class Bounds:
    """What steps must stay in, and how long they are."""

    rates: Tensor
    """[n, 14]."""
    ceilings: Tensor
    """[n] largest log scale."""
    smallest_log_scale: float


def adam_step(state: AdamState, gradient: Tensor, bounds: Bounds, decays: Decays) -> tuple[AdamState, Tensor]:
    """The state after one step down `gradient` [n, 14], and [n] bool: which rows were refused it.

    Rows that nothing pulls at are left alone; those that would not stay finite keep their values and forget their
    moments. What is given is left as it is.
    """
    pulled = (gradient != 0).any(1)
    taken = state.steps + pulled
    k, first, second = taken[:, None].to(gradient.dtype).clamp_min(1), decays.first, decays.second
    m = state.moment1.lerp(gradient, (1 - first) * pulled[:, None])
    v = state.moment2 * torch.where(pulled, second, 1.0)[:, None]
    v.addcmul_(gradient, gradient, value=1 - second)
    update = (m / (1 - first**k)).div_((v / (1 - second**k)).sqrt_().add_(1e-12))
    values = state.values - update.mul_(bounds.rates * pulled[:, None])
    scales, rgb = values[:, LOG_SCALE], values[:, RGB]
    torch.minimum(scales, bounds.ceilings[:, None], out=scales)
    scales.clamp_(min=bounds.smallest_log_scale)
    rgb.clamp_(0, 1)
    finite = torch.isfinite(values).all(1)
    values = torch.where((finite & pulled)[:, None], values, state.values)
    m, v = (torch.where(finite[:, None], of, 0) for of in (m, v))
    return AdamState(values, m, v, torch.where(finite, taken, 0)), ~finite
