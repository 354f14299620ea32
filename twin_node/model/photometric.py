"""What renderings are held to, and the gradient of what they miss it by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from twin_node import splat
from twin_node.model.rendering import Rendering, Sheet, Shots, Splats, shoot, shots_of
from twin_node.model.transfers import sent
from twin_node.scene import Bool, Float32, View

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
    """What is fitted to: how the views are drawn, and what they should show.

    Images of several sizes are brought to one by rows below and columns to the right that count for nothing.
    """

    shots: Shots
    targets: Targets
    sizes: Sequence[tuple[int, int]]
    """Height and width of the views' own images."""

    def own(self, sheet: Sheet) -> list[Rendering]:
        """What the cameras saw on a sheet, view by view in the size of its own images."""
        of_each = zip(sheet.rgbd, sheet.alpha, self.sizes, strict=True)
        return [Rendering(rgbd[:h, :w].contiguous(), alpha[:h, :w].contiguous()) for rgbd, alpha, (h, w) in of_each]


def goal_of(
    views: Sequence[View],
    masks: Sequence[Bool | None],
    backdrops: Sequence[Tensor] | None,
    device: torch.device,
    images: Sequence[Float32] | None = None,
) -> Goal:
    """The views' images (and depths) inside `masks` [H, W] (None: all pixels), before `backdrops` [H, W, 4].

    Each view weighs the same, however few of its pixels count: those inside its mask that are valid. `images`
    [H, W, 3] are theirs, 0 to 1, if at hand. All of a view are of its own size.
    """
    sizes = [(view.camera.height, view.camera.width) for view in views]
    size = (max(rows for rows, _ in sizes), max(columns for _, columns in sizes))
    cameras = [view.camera for view in views]
    if any(own != size for own in sizes):
        cameras = [replace(camera, height=size[0], width=size[1]) for camera in cameras]
        masks = _whole(masks, sizes)  # what is added is not drawn
    drawn = None if all(mask is None for mask in masks) else _whole(masks, sizes)
    behind = None if backdrops is None else [_grown(backdrop, size) for backdrop in backdrops]
    return Goal(
        shots_of(cameras, drawn, behind, device),
        Targets(
            _colours(views, images, size, device),
            _weights([_counted(*of) for of in zip(views, masks, strict=True)], sizes, size, device),
            _depths(views, size, device),
        ),
        sizes,
    )


def _counted(view: View, mask: Bool | None) -> Bool | None:
    if mask is None or view.valid is None:
        return view.valid if mask is None else mask
    return mask & view.valid


def _whole(masks: Sequence[Bool | None], sizes: Sequence[tuple[int, int]]) -> list[Bool]:
    """The masks, of all pixels where there is none."""
    return [np.ones(size, bool) if mask is None else mask for mask, size in zip(masks, sizes, strict=True)]


def _colours(
    views: Sequence[View], images: Sequence[Float32] | None, size: tuple[int, int], device: torch.device
) -> Tensor:
    """[C, *size, 3] the views' images, 0 to 1; another device is sent bytes, and makes numbers of them itself."""
    if device.type != "cpu":
        return sent([view.rgb for view in views], size, device).float().div_(255)
    if images is None:
        images = [np.divide(view.rgb, np.float32(255), dtype=np.float32) for view in views]
    return sent(images, size, device)


def _weights(
    counted: Sequence[Bool | None], sizes: Sequence[tuple[int, int]], size: tuple[int, int], device: torch.device
) -> Tensor | None:
    """[C, *size] ones where pixels count, scaled so that each view's add up to the same; None where all count."""
    if all(mask is None for mask in counted):
        return None
    whole = _whole(counted, sizes)
    pixels = size[0] * size[1]
    scales = [1 / np.float32(max(int(np.count_nonzero(mask)), 1) / pixels) for mask in whole]
    if device.type != "cpu":
        own = torch.tensor(scales, dtype=torch.float32)[:, None, None].to(device)
        return sent(whole, size, device) * own
    weights = np.zeros((len(counted), *size), np.float32)
    for mask, scale, (height, width), out in zip(whole, scales, sizes, weights, strict=True):
        np.multiply(mask, scale, out=out[:height, :width])
    return torch.from_numpy(weights)


def _depths(views: Sequence[View], size: tuple[int, int], device: torch.device) -> Tensor | None:
    """[C, *size] m, 0 where unknown; None where no view measures it."""
    if all(view.depth is None for view in views):
        return None
    depths = [np.zeros(view.rgb.shape[:2], np.float32) if view.depth is None else view.depth for view in views]
    return sent(depths, size, device)


def _grown(image: Tensor, size: tuple[int, int]) -> Tensor:
    """[*size, 4] of [H, W, 4]: the image itself where it is as large, by which what was made of it is found again."""
    if image.shape[:2] == size:
        return image
    return pad(image, (0, 0, 0, size[1] - image.shape[1], 0, size[0] - image.shape[0]))


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
    return len(sheet.rgbd) * loss


@dataclass(frozen=True)
class Differentiated:
    """What was seen, and which way is down."""

    sheet: Sheet
    gradient: Splats
    """Of the photometric loss with respect to the Gaussians that were drawn."""
    loss: Tensor
    """A scalar, without gradients."""


def differentiate(splats: Splats, goal: Goal) -> Differentiated:
    """Draws `splats` and takes the loss's gradient back to them."""
    leaf = Splats(*(field.detach().requires_grad_() for field in vars(splats).values()))
    sheet = shoot(leaf, goal.shots)
    loss = photometric(sheet, goal.targets)
    torch.autograd.backward(loss)
    grads = [torch.zeros_like(field) if field.grad is None else field.grad for field in vars(leaf).values()]
    detached = Sheet(sheet.rgbd.detach(), sheet.alpha.detach())
    return Differentiated(detached, Splats(*grads), loss.detach())
