"""What renderings are held to, and the gradient of what they miss it by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.rendering import Sheet, Splats, by_size, draw
from twin_node.scene import Bool, Camera, Float32, View

DEPTH_WEIGHT = 0.05
"""Weight of a metre of depth error beside the photometric loss."""


@dataclass(frozen=True)
class Targets:
    """What the renderings of cameras of one size are held to."""

    rgb: Tensor
    """[C, H, W, 3] 0 to 1."""
    weights: Tensor | None
    """[C, H, W]; None: all pixels count alike."""
    depth: Tensor | None
    """[C, H, W] m, 0 where unknown; None where no view measures it."""


def targets_of(
    views: Sequence[View],
    masks: Sequence[Bool | None],
    device: torch.device,
    images: Sequence[Float32] | None = None,
) -> list[Targets]:
    """The views' images (and depths) inside `masks` [H, W] and their valid pixels, one record per size of image.

    Each view weighs the same, however few of its pixels count. `images` [H, W, 3] are theirs, 0 to 1, if at hand.
    """
    out = []
    for chosen in by_size([view.camera for view in views]):
        part = [views[i] for i in chosen]
        counted = [_counted(views[i], masks[i]) for i in chosen]
        depths = [np.zeros(view.rgb.shape[:2], np.float32) if view.depth is None else view.depth for view in part]
        colours = _colours(part) if images is None else np.stack([images[i] for i in chosen])
        out.append(
            Targets(
                torch.from_numpy(colours).to(device),
                None if all(one is None for one in counted) else torch.from_numpy(_weights(part, counted)).to(device),
                None if all(view.depth is None for view in part) else torch.from_numpy(np.stack(depths)).to(device),
            )
        )
    return out


def _counted(view: View, mask: Bool | None) -> Bool | None:
    if mask is None or view.valid is None:
        return view.valid if mask is None else mask
    return mask & view.valid


def _colours(views: Sequence[View]) -> Float32:
    """[C, H, W, 3] their images, 0 to 1."""
    return np.divide(np.stack([view.rgb for view in views]), np.float32(255), dtype=np.float32)


def _weights(views: Sequence[View], counted: Sequence[Bool | None]) -> Float32:
    """[C, H, W] ones where pixels count, scaled so that each view's add up to the same."""
    masks = [np.ones(v.rgb.shape[:2], bool) if m is None else m for v, m in zip(views, counted, strict=True)]
    shares = [np.float32(max(int(np.count_nonzero(mask)), 1) / mask.size) for mask in masks]
    weights = np.empty((len(masks), *masks[0].shape), np.float32)
    for mask, share, out in zip(masks, shares, weights, strict=True):
        np.multiply(mask, 1 / share, out=out)
    return weights


def photometric(sheets: Sequence[Sheet], targets: Sequence[Targets]) -> Tensor:
    """Sum over views of L1, on depth too where it is measured."""
    total = sheets[0].rgbd.new_zeros(())
    for sheet, target in zip(sheets, targets, strict=True):
        loss = splat.image_loss(
            sheet.rgbd,
            target.rgb,
            weights=target.weights,
            l1=1.0,
            ssim=0.0,
            target_depth=target.depth,
            depth_weight=0.0 if target.depth is None else DEPTH_WEIGHT,
        )
        total = total + len(sheet.indices) * loss
    return total


@dataclass(frozen=True)
class Goal:
    """What is fitted to: the views' cameras, the pixels that count, and what they should show."""

    cameras: Sequence[Camera]
    masks: Sequence[Bool] | None
    targets: Sequence[Targets]
    backdrops: Sequence[Tensor] | None = None
    """What stands behind all that is drawn, see `rendering.render`."""


@dataclass(frozen=True)
class Differentiated:
    """What was seen, and which way is down."""

    sheets: list[Sheet]
    gradient: Splats
    """Of the photometric loss with respect to the Gaussians that were drawn."""
    loss: float


def differentiate(splats: Splats, goal: Goal) -> Differentiated:
    """Draws `splats` and takes the loss's gradient back to them."""
    leaf = Splats(*(field.detach().requires_grad_() for field in vars(splats).values()))
    sheets = draw(leaf, goal.cameras, goal.masks, goal.backdrops)
    loss = photometric(sheets, goal.targets)
    torch.autograd.backward(loss)
    grads = [torch.zeros_like(field) if field.grad is None else field.grad for field in vars(leaf).values()]
    detached = [replace(sheet, rgbd=sheet.rgbd.detach(), alpha=sheet.alpha.detach()) for sheet in sheets]
    return Differentiated(detached, Splats(*grads), float(loss.detach()))
