"""Gradient steps: canonical attributes of selected Gaussians, and the poses of their nodes, towards the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node import splat
from twin_node.model.backgrounds import grow
from twin_node.model.gaussians import LOG_SCALE, LOGIT, MEAN, QUAT, RGB, WIDTH, Gaussians
from twin_node.model.motion import Motion
from twin_node.model.observation import Observed
from twin_node.model.parameters import TrackParameters
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering, join, render
from twin_node.scene import Bool, View

RATES = torch.zeros(WIDTH)
RATES[MEAN] = 0.08
RATES[QUAT] = 5e-3
RATES[LOG_SCALE] = 1.5e-2
RATES[LOGIT] = 5e-2
RATES[RGB] = 1.5e-2
"""Adam's rate per column; that of the mean is in units of the Gaussian's own size, so that no scene scale is needed."""


REGULARITY = 1e-3
"""Weight of the field's own regulariser beside the photometric loss (4DGS: 2e-4 in space, 1e-3 in time)."""
CANONICAL_SHARE = 0.5
"""Share of the mean's rate while things move: motion belongs to the nodes, and what is left over to the shape."""


@dataclass(frozen=True)
class Target:
    """What the rendering of one view is held to."""

    rgb: Tensor
    """[H, W, 3] 0 to 1."""
    weights: Tensor | None
    """[H, W]; None: all pixels count alike."""
    depth: Tensor | None
    """[H, W] m, 0 where unknown."""


def target_of(view: View, device: torch.device, mask: Bool | None = None) -> Target:
    """The view's image (and depth, where it has one) inside `mask` [H, W] and its valid pixels."""
    chosen = view.valid if mask is None else (mask if view.valid is None else mask & view.valid)
    return Target(
        torch.from_numpy(view.rgb).to(device).float() / 255,
        None if chosen is None else torch.from_numpy(chosen).to(device).float(),
        None if view.depth is None else torch.from_numpy(view.depth).to(device),
    )


def photometric(renderings: Sequence[Rendering], targets: Sequence[Target]) -> Tensor:
    """Sum over views of 0.8 L1 + 0.2 (1 - SSIM), and Huber-free L1 on depth where it is measured."""
    total = renderings[0].rgb.new_zeros(())
    for rendering, target in zip(renderings, targets, strict=True):
        weights = None if target.weights is None else target.weights[None]
        depth = None if target.depth is None else rendering.depth[None]
        goal = None if target.depth is None else target.depth[None]
        total = total + splat.image_loss(
            rendering.rgb[None],
            target.rgb[None],
            weights=weights,
            depth=depth,
            target_depth=goal,
            depth_weight=0.0 if depth is None else 0.2,
        )
    return total


def fit_all(gaussians: Gaussians, views: Sequence[View], steps: int) -> None:
    """Fits every Gaussian, none of which moves, to one set of views."""
    rows = torch.nonzero(gaussians.alive)[:, 0]
    targets = [target_of(view, gaussians.values.device) for view in views]
    cameras = [view.camera for view in views]
    for step in range(steps):
        values = gaussians.values[rows].requires_grad_()
        torch.autograd.backward(photometric(render(gaussians.standing(values), cameras), targets))
        decay = 0.1 ** (step / steps)
        _descend(gaussians, rows, values, decay, 1.0)


def _descend(gaussians: Gaussians, rows: Tensor, values: Tensor, factor: float, mean_share: float) -> None:
    gradient = values.grad
    if gradient is None or not len(rows):
        return
    rates = (RATES.to(values.device) * factor).expand(len(rows), -1).clone()
    rates[:, MEAN] *= mean_share * gaussians.values[rows, LOG_SCALE].exp().mean(-1, keepdim=True)
    gaussians.descend(rows, gradient, rates)


def fit_window(
    gaussians: Gaussians,
    motion: Motion,
    observed: Sequence[Observed],
    near: Tensor,
    revised: Tensor,
    parameters: TrackParameters,
) -> None:
    """A few steps on the Gaussians that move, inside the pixels that changed, and on `revised` [r] STATIC rows.

    Each view is fitted at its own time. `near` are other rows that can show, which are not touched. Where a node is
    DEFORMABLE the field learns along.
    """
    device = gaussians.values.device
    rows = torch.cat([gaussians.moving_rows, revised])
    if not len(rows):
        return
    kept = near[~torch.isin(near, revised)]
    masks = [one.active for one in observed]
    if len(revised):
        points = gaussians.values[revised, MEAN].cpu().numpy()
        masks = [mask | (_footprint(one, points) & one.usable) for mask, one in zip(masks, observed, strict=True)]
    targets = [target_of(one.view, device, mask) for one, mask in zip(observed, masks, strict=True)]
    cameras = [one.view.camera for one in observed]
    offsets = [one.offset_s for one in observed]
    poses, stamps = motion.poses(offsets), motion.stamps(offsets)
    with torch.no_grad():
        static = motion.place(gaussians, kept, poses, stamps)
    for _ in range(parameters.steps):
        values = gaussians.values[rows].requires_grad_()
        splats = join(static, motion.place_values(values, gaussians, rows, poses, stamps))
        loss = photometric(render(splats, cameras, masks), targets)
        torch.autograd.backward(loss + REGULARITY * motion.field.regularity() if motion.bends else loss)
        motion.descend()
        _descend(gaussians, rows, values, parameters.learning_rate, CANONICAL_SHARE)


def _footprint(one: Observed, points: NDArray[np.floating]) -> Bool:
    """[H, W] pixels at and around the projections of points [n, 3]."""
    seen = look(one.view.camera, points)
    mask = np.zeros(one.usable.shape, bool)
    mask[seen.rows[seen.inside], seen.columns[seen.inside]] = True
    return grow(mask, 2)
