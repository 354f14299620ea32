"""What renderings are held to, and the gradient of what they miss it by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import pad

from twin_node import splat
from twin_node.model.rendering import Rendering, Sheet, Splats, draw
from twin_node.scene import Bool, Camera, Float32, View

DEPTH_WEIGHT = 0.05
"""Weight of a metre of depth error beside the photometric loss."""


@dataclass(frozen=True)
class Targets:
    """What renderings are held to."""

    rgb: Tensor
    """[C, H, W, 3] 0 to 1."""
    weights: Tensor | None
    """[C, H, W]; None: all pixels count alike."""
    depth: Tensor | None
    """[C, H, W] m, 0 where unknown; None where no view measures it."""


@dataclass(frozen=True)
class Goal:
    """What is fitted to: the views' cameras, the pixels that count, and what they should show.

    Images of several sizes are brought to one by rows below and columns to the right that count for nothing.
    """

    cameras: Sequence[Camera]
    """All of one size."""
    masks: Sequence[Bool] | None
    """[H, W] pixels that are drawn."""
    targets: Targets
    backdrops: Sequence[Tensor] | None
    """What stands behind all that is drawn, see `rendering.render`."""
    sizes: Sequence[tuple[int, int]]
    """Height and width of the views' own images."""

    def own(self, sheet: Sheet) -> list[Rendering]:
        """What each view saw, in the size of its own images."""
        of_each = zip(sheet.rgbd, sheet.alpha, self.sizes, strict=True)
        return [Rendering(rgbd[:h, :w].contiguous(), alpha[:h, :w].contiguous()) for rgbd, alpha, (h, w) in of_each]


def goal_of(
    views: Sequence[View],
    masks: Sequence[Bool | None],
    backdrops: Sequence[Tensor] | None,
    device: torch.device,
    images: Sequence[Float32] | None = None,
) -> Goal:
    """The views' images (and depths) inside `masks` [H, W], before `backdrops` [H, W, 4].

    Each view weighs the same, however few of its pixels count: those inside its mask that are valid. `images`
    [H, W, 3] are theirs, 0 to 1, if at hand.
    """
    sizes = [view.rgb.shape[:2] for view in views]
    height, width = (max(sides) for sides in zip(*sizes, strict=True))
    if any(size != (height, width) for size in sizes):
        views = [_widened(view, height, width) for view in views]
        masks = [_padded(one, height, width) for one in _whole(masks, sizes)]
        images = None if images is None else [_padded(image, height, width) for image in images]
        if backdrops is not None:
            backdrops = [pad(one, (0, 0, 0, width - one.shape[1], 0, height - one.shape[0])) for one in backdrops]
    drawn = None if all(mask is None for mask in masks) else _whole(masks, [(height, width)] * len(views))
    return Goal([view.camera for view in views], drawn, _targets(views, masks, device, images), backdrops, sizes)


def _whole(masks: Sequence[Bool | None], sizes: Sequence[tuple[int, int]]) -> list[Bool]:
    """The masks, of all pixels where there is none."""
    return [np.ones(size, bool) if mask is None else mask for mask, size in zip(masks, sizes, strict=True)]


def _widened(view: View, height: int, width: int) -> View:
    return replace(
        view,
        camera=replace(view.camera, height=height, width=width),
        rgb=_padded(view.rgb, height, width),
        depth=None if view.depth is None else _padded(view.depth, height, width),
        valid=None if view.valid is None else _padded(view.valid, height, width),
    )


def _padded(image: NDArray[Any], height: int, width: int) -> NDArray[Any]:
    """[height, width, ...] with zeros below and to the right of an image."""
    sides = [(0, height - image.shape[0]), (0, width - image.shape[1])]
    return np.pad(image, sides + [(0, 0)] * (image.ndim - 2))


def _targets(
    views: Sequence[View], masks: Sequence[Bool | None], device: torch.device, images: Sequence[Float32] | None
) -> Targets:
    counted = [_counted(view, mask) for view, mask in zip(views, masks, strict=True)]
    depths = [np.zeros(view.rgb.shape[:2], np.float32) if view.depth is None else view.depth for view in views]
    colours = _colours(views) if images is None else np.stack(images)
    return Targets(
        torch.from_numpy(colours).to(device),
        None if all(one is None for one in counted) else torch.from_numpy(_weights(views, counted)).to(device),
        None if all(view.depth is None for view in views) else torch.from_numpy(np.stack(depths)).to(device),
    )


def _counted(view: View, mask: Bool | None) -> Bool | None:
    if mask is None or view.valid is None:
        return view.valid if mask is None else mask
    return mask & view.valid


def _colours(views: Sequence[View]) -> Float32:
    """[C, H, W, 3] their images, 0 to 1."""
    return np.divide(np.stack([view.rgb for view in views]), np.float32(255), dtype=np.float32)


def _weights(views: Sequence[View], counted: Sequence[Bool | None]) -> Float32:
    """[C, H, W] ones where pixels count, scaled so that each view's add up to the same."""
    masks = _whole(counted, [view.rgb.shape[:2] for view in views])
    shares = [np.float32(max(int(np.count_nonzero(mask)), 1) / mask.size) for mask in masks]
    weights = np.empty((len(masks), *masks[0].shape), np.float32)
    for mask, share, out in zip(masks, shares, weights, strict=True):
        np.multiply(mask, 1 / share, out=out)
    return weights


def photometric(sheet: Sheet, targets: Targets) -> Tensor:
    """Sum over views of L1, on depth too where it is measured."""
    loss = splat.image_loss(
        sheet.rgbd,
        targets.rgb,
        weights=targets.weights,
        l1=1.0,
        ssim=0.0,
        target_depth=targets.depth,
        depth_weight=0.0 if targets.depth is None else DEPTH_WEIGHT,
    )
    return len(sheet.indices) * loss


@dataclass(frozen=True)
class Differentiated:
    """What was seen, and which way is down."""

    sheet: Sheet
    gradient: Splats
    """Of the photometric loss with respect to the Gaussians that were drawn."""
    loss: float


def differentiate(splats: Splats, goal: Goal) -> Differentiated:
    """Draws `splats` and takes the loss's gradient back to them."""
    leaf = Splats(*(field.detach().requires_grad_() for field in vars(splats).values()))
    [sheet] = draw(leaf, goal.cameras, goal.masks, goal.backdrops)
    loss = photometric(sheet, goal.targets)
    torch.autograd.backward(loss)
    grads = [torch.zeros_like(field) if field.grad is None else field.grad for field in vars(leaf).values()]
    detached = replace(sheet, rgbd=sheet.rgbd.detach(), alpha=sheet.alpha.detach())
    return Differentiated(detached, Splats(*grads), float(loss.detach()))
