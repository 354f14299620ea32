"""The image loss of training, L1 + (1 - SSIM) + depth L1, fused with its gradient on the CPU."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.arguments import require_finite
from twin_node.splat.request import fill, not_finite_is_named

WINDOW_TAPS = 11
"""Width of the SSIM's window, pixels (Wang et al. 2004)."""
WINDOW_SIGMA = 1.5
"""Its standard deviation, pixels."""
C1, C2 = 0.01**2, 0.03**2
"""The SSIM's constants for a data range of 1."""


@dataclass(frozen=True)
class _Loss:
    """Checked arguments: B images in one leading dimension."""

    render: Tensor
    """[B, H, W, 3], or [B, H, W, 4] with the depth last."""
    target: Tensor
    """[B, H, W, 3]."""
    weights: Tensor | None
    """[B, H, W]."""
    target_depth: Tensor | None
    """[B, H, W]."""
    l1: float
    ssim: float
    depth_weight: float


def image_loss(
    render: Tensor,  # [..., H, W, 3], or [..., H, W, 4] with the depth last
    target: Tensor,  # [..., H, W, 3]
    *,
    weights: Tensor | None = None,  # [..., H, W]
    target_depth: Tensor | None = None,  # [..., H, W] or [..., H, W, 1]
    l1: float = 0.8,
    ssim: float = 0.2,
    depth_weight: float = 0.0,
) -> Tensor:
    """`l1 |render - target| + ssim (1 - SSIM) + depth_weight |depth - target_depth|` as a scalar for render and depth.

    Each term is the mean over all pixels (and channels) of all images, weighted by `weights` where given (at least 0;
    a bool mask will do). Pixels of weight 0 count as equal to their target where the SSIM's window reaches over them,
    send back no gradient, and cost nothing outside the box that the others span. Depth counts where `target_depth` is
    positive (0 is unknown). The rendered depth is the fourth channel of `render`, as `rasterize` gives it with
    `RGB+ED`. Colours 0 to 1; SSIM after Wang et al. 2004, 11x11 window, zero padding.

    Raises `ValueError` naming an argument of wrong shape, dtype or device, or one that is not finite.
    """
    call = _check(render, target, weights, target_depth, l1, ssim, depth_weight)
    library = native.kernels_for(call.render.device)
    if library is None or call.render.dtype != torch.float32:
        return _reference(call)
    loss: Tensor = _FusedLoss.apply(call.render, call, library)  # type: ignore[no-untyped-call]
    return loss


def image_loss_reference(
    render: Tensor,
    target: Tensor,
    *,
    weights: Tensor | None = None,
    target_depth: Tensor | None = None,
    l1: float = 0.8,
    ssim: float = 0.2,
    depth_weight: float = 0.0,
) -> Tensor:
    """`image_loss` in plain torch, float32 or float64, on any device: the reference of the tests."""
    return _reference(_check(render, target, weights, target_depth, l1, ssim, depth_weight))


def _check(
    render: Tensor,
    target: Tensor,
    weights: Tensor | None,
    target_depth: Tensor | None,
    l1: float,
    ssim: float,
    depth_weight: float,
) -> _Loss:
    if render.dim() < 3 or render.shape[-1] not in (3, 4) or render.numel() == 0:
        raise ValueError(f"render: expected shape [..., H, W, 3 or 4] without a zero, found {list(render.shape)}")
    if render.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"render: expected float32 or float64, found {render.dtype}")
    pixels = tuple(render.shape[:-1])
    if weights is not None and weights.dtype == torch.bool:
        weights = weights.to(render.dtype)
    _check_like("target", target, (*pixels, 3), render)
    if weights is not None:
        _check_like("weights", weights, pixels, render)
    if target_depth is not None:
        if tuple(target_depth.shape) == (*pixels, 1):
            target_depth = target_depth.squeeze(-1)
        _check_like("target_depth", target_depth, pixels, render)
    if depth_weight > 0 and (target_depth is None or render.shape[-1] != 4):
        raise ValueError("depth_weight: expected 0 without a rendered depth and a target_depth")
    for name, value in (("l1", l1), ("ssim", ssim), ("depth_weight", depth_weight)):
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name}: expected a finite value of at least 0, found {value}")
    return _Loss(
        render=render.reshape(-1, *render.shape[-3:]),
        target=target.detach().reshape(-1, *target.shape[-3:]),
        weights=None if weights is None else weights.detach().reshape(-1, *pixels[-2:]),
        target_depth=None if target_depth is None else target_depth.detach().reshape(-1, *pixels[-2:]),
        l1=l1,
        ssim=ssim,
        depth_weight=depth_weight,
    )


def _check_like(name: str, tensor: Tensor, shape: tuple[int, ...], render: Tensor) -> None:
    if tuple(tensor.shape) != shape or tensor.dtype != render.dtype or tensor.device != render.device:
        raise ValueError(
            f"{name}: expected {list(shape)} {render.dtype} on {render.device} as the render is, "
            f"found {list(tensor.shape)} {tensor.dtype} on {tensor.device}"
        )


class _FusedLoss(torch.autograd.Function):
    """The library's loss; the gradient is made with the value and waits for the backward pass."""

    @staticmethod
    def forward(ctx: Any, render: Tensor, call: _Loss, library: native.SplatLibrary) -> Tensor:
        given = {"render": render, "target": call.target, "weights": call.weights, "target_depth": call.target_depth}
        inputs = {name: None if t is None else t.contiguous() for name, t in given.items()}
        gradient = torch.zeros_like(render, memory_format=torch.contiguous_format)
        loss = render.new_empty(1, dtype=torch.float64)
        images, height, width, channels = render.shape
        request = fill(
            native.LossRequest,
            images=images,
            height=height,
            width=width,
            channels=channels,
            threads=thread_count(),
            l1=call.l1,
            ssim=call.ssim,
            depth_weight=call.depth_weight,
            **inputs,
            gradient=gradient,
            loss=loss,
        )
        with not_finite_is_named(inputs):
            library.image_loss(request)
        ctx.save_for_backward(gradient)
        return loss[0].float()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (gradient,) = ctx.saved_tensors
        return gradient * gradients[0], None, None


def _reference(call: _Loss) -> Tensor:
    require_finite({name: getattr(call, name) for name in ("render", "target", "weights", "target_depth")})
    return _missed_by(call)


def unchecked_loss(
    render: Tensor, target: Tensor, weights: Tensor | None, target_depth: Tensor | None, depth_weight: float
) -> Tensor:
    """`image_loss` with `l1` alone, in torch, for images that are known to fit; the device is not waited for."""
    return _missed_by(_Loss(render, target, weights, target_depth, 1.0, 0.0, depth_weight))


def _missed_by(call: _Loss) -> Tensor:
    weights = torch.ones_like(call.target[..., 0]) if call.weights is None else call.weights.clamp_min(0)
    color = torch.where(weights[..., None] > 0, call.render[..., :3], call.target)
    missed = call.l1 * (color - call.target).abs().mean(-1)
    if call.ssim > 0:
        missed = missed + call.ssim * (1 - _ssim_map(color, call.target).mean(-1))
    loss = _mean(missed, weights)
    if call.depth_weight > 0 and call.target_depth is not None:
        error = (call.render[..., 3] - call.target_depth).abs()
        loss = loss + call.depth_weight * _mean(error, torch.where(call.target_depth > 0, weights, 0))
    return loss


def _mean(errors: Tensor, weights: Tensor) -> Tensor:
    """The weighted mean; 0 where nothing counts."""
    return (weights * errors).sum() / weights.sum().clamp_min(torch.finfo(weights.dtype).tiny)


@cache
def _window(dtype: torch.dtype, device: torch.device) -> Tensor:
    offsets = torch.arange(WINDOW_TAPS, dtype=torch.float64) - WINDOW_TAPS // 2
    taps = torch.exp(-offsets.square() / (2 * WINDOW_SIGMA**2))
    return (taps / taps.sum()).to(dtype=dtype, device=device)


def _ssim_map(x: Tensor, y: Tensor) -> Tensor:
    """[B, H, W, 3] structural similarity of two batches of images."""
    taps, pad = _window(x.dtype, x.device), WINDOW_TAPS // 2

    def local_mean(image: Tensor) -> Tensor:
        planes = image.permute(0, 3, 1, 2).reshape(-1, 1, *image.shape[1:3])
        planes = F.conv2d(planes, taps.view(1, 1, -1, 1), padding=(pad, 0))
        planes = F.conv2d(planes, taps.view(1, 1, 1, -1), padding=(0, pad))
        return planes.reshape(image.shape[0], 3, *image.shape[1:3]).permute(0, 2, 3, 1)

    mx, my = local_mean(x), local_mean(y)
    xx, yy, xy = local_mean(x * x) - mx * mx, local_mean(y * y) - my * my, local_mean(x * y) - mx * my
    return (2 * mx * my + C1) * (2 * xy + C2) / ((mx * mx + my * my + C1) * (xx + yy + C2))
