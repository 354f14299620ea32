"""Gradient steps: canonical attributes of selected Gaussians, and the poses of their nodes, towards the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node import splat
from twin_node.model.backgrounds import grow
from twin_node.model.carriage import Bend, Carriage, carry
from twin_node.model.gaussians import LOG_SCALE, LOGIT, MEAN, QUAT, RGB, WIDTH, Gaussians, activated
from twin_node.model.motion import Motion
from twin_node.model.observation import Observed
from twin_node.model.parameters import TrackParameters
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering, Sheet, Splats, by_size, draw, join, split
from twin_node.model.rotations import quat_product
from twin_node.scene import Bool, Camera, Float32, View

RATES = torch.zeros(WIDTH)
RATES[MEAN] = 0.08
RATES[QUAT] = 5e-3
RATES[LOG_SCALE] = 1.5e-2
RATES[LOGIT] = 5e-2
RATES[RGB] = 1.5e-2
"""Adam's rate per column; that of the mean is in units of the Gaussian's own size, so that no scene scale is needed."""


REGULARITY = 1e-3
"""Weight of the field's own regulariser beside the photometric loss (4DGS: 2e-4 in space, 1e-3 in time)."""
CANONICAL_SHARE = 1.5
"""What the mean's rate is multiplied by while things move: it also makes good what the nodes' motion leaves over."""
REVISED_SHARE = 0.3
"""What the rates of STATIC Gaussians are multiplied by when they are revised: noise must not wear them down."""
DEPTH_WEIGHT = 0.2
"""Weight of a metre of depth error beside the photometric loss."""


SKIRT_PX = 5
"""Pixels around the active ones that count too, so that nothing moving grows tails over what stands still."""


@dataclass(frozen=True)
class Targets:
    """What the renderings of cameras of one size are held to."""

    rgb: Tensor
    """[C, H, W, 3] 0 to 1."""
    weights: Tensor | None
    """[C, H, W]; None: all pixels count alike."""
    depth: Tensor | None
    """[C, H, W] m, 0 where unknown; None where no view measures it."""


def targets_of(views: Sequence[View], masks: Sequence[Bool | None], device: torch.device) -> list[Targets]:
    """The views' images (and depths) inside `masks` [H, W] and their valid pixels, one record per size of image.

    Each view weighs the same, however few of its pixels count.
    """
    out = []
    for chosen in by_size([view.camera for view in views]):
        part = [views[i] for i in chosen]
        counted = [_counted(views[i], masks[i]) for i in chosen]
        depths = [np.zeros(view.rgb.shape[:2], np.float32) if view.depth is None else view.depth for view in part]
        out.append(
            Targets(
                torch.from_numpy(np.stack([view.rgb for view in part])).to(device).float() / 255,
                None if all(one is None for one in counted) else torch.from_numpy(_weights(part, counted)).to(device),
                None if all(view.depth is None for view in part) else torch.from_numpy(np.stack(depths)).to(device),
            )
        )
    return out


def _counted(view: View, mask: Bool | None) -> Bool | None:
    if mask is None or view.valid is None:
        return view.valid if mask is None else mask
    return mask & view.valid


def _weights(views: Sequence[View], counted: Sequence[Bool | None]) -> Float32:
    """[C, H, W] ones where pixels count, scaled so that each view's add up to the same."""
    masks = [np.ones(v.rgb.shape[:2], bool) if m is None else m for v, m in zip(views, counted, strict=True)]
    return np.stack([mask / np.float32(max(mask.mean(), 1 / mask.size)) for mask in masks]).astype(np.float32)


def photometric(sheets: Sequence[Sheet], targets: Sequence[Targets]) -> Tensor:
    """Sum over views of 0.8 L1 + 0.2 (1 - SSIM), and Huber-free L1 on depth where it is measured."""
    total = sheets[0].rgbd.new_zeros(())
    for sheet, target in zip(sheets, targets, strict=True):
        loss = splat.image_loss(
            sheet.rgbd,
            target.rgb,
            weights=target.weights,
            target_depth=target.depth,
            depth_weight=0.0 if target.depth is None else DEPTH_WEIGHT,
        )
        total = total + len(sheet.indices) * loss
    return total


def fit_all(gaussians: Gaussians, views: Sequence[View], steps: int) -> None:
    """Fits every Gaussian, none of which moves, to one set of views."""
    targets = targets_of(views, [None] * len(views), gaussians.values.device)
    goal = _Goal([view.camera for view in views], None, targets)
    descent = gaussians.descent(torch.nonzero(gaussians.alive)[:, 0])
    for step in range(steps):
        splats = gaussians.standing(descent.values)
        descent.step(
            _to_columns(splats, _differentiate(splats, goal).gradient), _rates(descent.values, 0.1 ** (step / steps))
        )
    descent.end()


def fit_window(
    gaussians: Gaussians,
    motion: Motion,
    observed: Sequence[Observed],
    masks: Sequence[Bool],
    near: Tensor,
    revised: Tensor,
    parameters: TrackParameters,
) -> list[Rendering]:
    """A few steps on the Gaussians that move, inside `masks` [H, W], and on `revised` [r] STATIC rows.

    Each view is fitted at its own time. `near` are other rows that can show, which are not touched. Where a node is
    DEFORMABLE the field learns along, from the last step. Returns what the views saw before that step; empty where
    nothing learns.
    """
    rows = torch.cat([gaussians.moving_rows, revised])
    if not len(rows) or not parameters.steps:
        return []
    offsets = [one.offset_s for one in observed]
    poses, stamps = motion.poses(offsets), motion.stamps(offsets)
    views = [one.view for one in observed]
    goal = _Goal([view.camera for view in views], masks, targets_of(views, masks, gaussians.values.device))
    with torch.no_grad():
        static = motion.place(gaussians, near[~torch.isin(near, revised)], poses, stamps)
    descent = gaussians.descent(rows)
    rates = _window_rates(descent.values, len(revised), parameters.learning_rate)
    rigid, bend = carry(poses, gaussians.nodes[rows]), motion.bend(descent.values, gaussians, rows, stamps)
    carriage = rigid if bend is None else _detached(rigid.bent(bend))
    sheets: list[Sheet] = []
    for step in range(parameters.steps):
        values = descent.values
        moving = activated(values, carriage.means(values[:, MEAN]), carriage.quats(values[:, QUAT]))
        seen = _differentiate(join(static, moving), goal)
        sheets = seen.sheets
        gradient = _tail(seen.gradient, len(rows))
        local = replace(
            gradient,
            means=carriage.means_gradient(gradient.means),
            quats=carriage.quats_gradient(gradient.quats),
        )
        descent.step(_to_columns(moving, local), rates)
        if bend is not None and step == parameters.steps - 1:
            _learn_field(motion, bend, values, local.means, rigid.quats_gradient(gradient.quats))
    descent.end()
    return split(sheets)


@dataclass(frozen=True)
class _Goal:
    """What is fitted to: the views' cameras, the pixels that count, and what they should show."""

    cameras: Sequence[Camera]
    masks: Sequence[Bool] | None
    targets: Sequence[Targets]


@dataclass(frozen=True)
class _Differentiated:
    sheets: list[Sheet]
    gradient: Splats
    """Of the photometric loss with respect to the Gaussians that were drawn."""


def _differentiate(splats: Splats, goal: _Goal) -> _Differentiated:
    leaf = Splats(*(field.detach().requires_grad_() for field in vars(splats).values()))
    sheets = draw(leaf, goal.cameras, goal.masks)
    torch.autograd.backward(photometric(sheets, goal.targets))
    grads = [torch.zeros_like(field) if field.grad is None else field.grad for field in vars(leaf).values()]
    detached = [replace(sheet, rgbd=sheet.rgbd.detach(), alpha=sheet.alpha.detach()) for sheet in sheets]
    return _Differentiated(detached, Splats(*grads))


def _tail(splats: Splats, count: int) -> Splats:
    """The last `count` Gaussians."""
    start = splats.means.shape[1] - count
    return Splats(
        splats.means[:, start:],
        splats.quats[:, start:],
        splats.scales[start:],
        splats.opacities[start:],
        splats.rgb[start:],
    )


def _detached(carriage: Carriage) -> Carriage:
    return Carriage(*(field.detach() for field in vars(carriage).values()))


def _learn_field(motion: Motion, bend: Bend, values: Tensor, of_means: Tensor, of_quats: Tensor) -> None:
    """One step of the field, from the gradients [T, n, ...] with respect to bent means and quaternions."""
    turned = quat_product(bend.turns, values[bend.chosen, QUAT])
    torch.autograd.backward([bend.offsets, turned], [of_means[:, bend.chosen], of_quats[:, bend.chosen]])
    torch.autograd.backward(REGULARITY * motion.field.regularity())
    motion.descend()


def _to_columns(splats: Splats, gradient: Splats) -> Tensor:
    """[n, 14] gradient with respect to `Gaussians.values`, from that with respect to the `splats` they stand for."""
    logit = gradient.opacities * splats.opacities * (1 - splats.opacities)
    columns = [
        gradient.means.sum(0),
        gradient.quats.sum(0),
        gradient.scales * splats.scales,
        logit[:, None],
        gradient.rgb,
    ]
    return torch.cat(columns, 1)


def _rates(values: Tensor, factor: float) -> Tensor:
    """[n, 14] Adam's rates of Gaussians `values` [n, 14]."""
    rates = (RATES.to(values.device) * factor).repeat(len(values), 1)
    rates[:, MEAN] *= values[:, LOG_SCALE].exp().mean(-1, keepdim=True)
    return rates


def _window_rates(values: Tensor, revised: int, factor: float) -> Tensor:
    """[n, 14] the same while things move; the last `revised` of the Gaussians are STATIC."""
    rates = _rates(values, factor)
    rates[:, MEAN] *= CANONICAL_SHARE
    rates[len(rates) - revised :] *= REVISED_SHARE
    return rates


def held_pixels(observed: Sequence[Observed], moving: Splats, revised: Tensor) -> list[Bool]:
    """Per view [H, W] the pixels that a rendering is held to: where something changed, and where what learns shows.

    `moving` are the Gaussians that move, at each view's time, `revised` [r, 3] the means of STATIC ones, m. Behind thin
    or loose surfaces moving Gaussians shine through: a view in which nothing moves there must have its say too.
    """
    masks = []
    for index, one in enumerate(observed):
        means = torch.cat([moving.means[index], revised]).cpu().numpy()
        masks.append((grow(one.active, SKIRT_PX) | _footprint(one, means)) & one.usable)
    return masks


def _footprint(one: Observed, points: NDArray[np.floating]) -> Bool:
    """[H, W] pixels at and around the projections of points [n, 3]."""
    seen = look(one.view.camera, points)
    mask = np.zeros(one.usable.shape, bool)
    mask[seen.rows[seen.inside], seen.columns[seen.inside]] = True
    return grow(mask, 2)
