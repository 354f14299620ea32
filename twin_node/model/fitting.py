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
from twin_node.model.gaussians import LOG_SCALE, LOGIT, MEAN, QUAT, RGB, SMALLEST, WIDTH, Gaussians, activated
from twin_node.model.motion import Motion
from twin_node.model.nodes import Poses
from twin_node.model.observation import Observed
from twin_node.model.photometric import DEPTH_WEIGHT, Goal, differentiate, targets_of
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering, Sheet, Splats, join, split
from twin_node.model.rotations import quat_product
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
CANONICAL_SHARE = 1.5
"""What the mean's rate is multiplied by while things move: it also makes good what the nodes' motion leaves over."""
WORSE, WORSE_FLOOR = 1.5, 1e-3
"""Times its value before the first step, plus so much, that the loss may have before the last one: steps that are taken
well halve it."""
SKIRT_PX = 5
"""Pixels around the active ones that count too, so that nothing moving grows tails over what stands still."""


def fit_all(gaussians: Gaussians, views: Sequence[View], steps: int) -> None:
    """Fits every Gaussian, none of which moves, to one set of views."""
    targets = targets_of(views, [None] * len(views), gaussians.values.device)
    goal = Goal([view.camera for view in views], None, targets)
    descent = gaussians.descent(torch.nonzero(gaussians.alive)[:, 0])
    for step in range(steps):
        splats = gaussians.standing(descent.values)
        descent.step(
            _to_columns(splats, differentiate(splats, goal).gradient), _rates(descent.values, 0.1 ** (step / steps))
        )
    descent.end()


def fit_moving(
    gaussians: Gaussians,
    motion: Motion,
    observed: Sequence[Observed],
    poses: Poses,
    masks: Sequence[Bool],
    bystanders: Tensor,
    steps: int,
    learning_rate: float,
) -> Fitted:
    """A few steps on the Gaussians that move, before the backgrounds, inside `masks` [H, W].

    Each view is fitted at its own time, for which `poses` holds the nodes'. `bystanders` are rows that can stand before
    what moves and are not touched. Where a node is DEFORMABLE the field learns along, from the last step. Steps that
    make the images worse are undone.
    """
    rows = gaussians.moving_rows
    if not len(rows) or not steps:
        return Fitted([], False)
    stamps = motion.stamps([one.offset_s for one in observed])
    views = [one.view for one in observed]
    targets = targets_of(views, masks, gaussians.values.device)
    backdrops = [one.background.backdrop for one in observed]
    goal = Goal([view.camera for view in views], masks, targets, backdrops)
    with torch.no_grad():
        static = motion.place(gaussians, bystanders, poses, stamps)
    values = gaussians.values[rows]
    rates = _rates(values, learning_rate)
    rates[:, MEAN] *= CANONICAL_SHARE
    rigid, bend = carry(poses, gaussians.nodes[rows]), motion.bend(gaussians.population(rows, motion.nodes), stamps)
    path = Path(rows, rigid if bend is None else _detached(rigid.bent(bend)), rates, static, goal)
    last = _descend(gaussians, path, steps if bend is None else max(steps - 1, 1))
    if _diverged(last.losses):
        gaussians.take(rows, values, *(torch.zeros_like(values),) * 2, torch.zeros_like(gaussians.steps[rows]))
        return Fitted([], True)
    if bend is not None:
        values = gaussians.values[rows]
        last = _descend(gaussians, path, 1)
        of_means = path.carriage.means_gradient(last.of_means)
        _learn_field(motion, bend, values, of_means, rigid.quats_gradient(last.of_quats))
    return Fitted(split(last.sheets), False)


def _diverged(losses: Sequence[float]) -> bool:
    """Whether the steps have made the images worse; noise and births may do so a little."""
    return not losses[-1] <= WORSE * losses[0] + WORSE_FLOOR


@dataclass(frozen=True)
class Fitted:
    """What a few steps have led to."""

    renderings: list[Rendering]
    """What the views saw before the last step; empty where nothing was learned."""
    diverged: bool
    """The steps made the images worse and were undone: the next ones should be smaller."""


@dataclass(frozen=True)
class Path:
    """What n Gaussians learn from, and how they are carried meanwhile."""

    rows: Tensor
    """[n]."""
    carriage: Carriage
    rates: Tensor
    """[n, 14]."""
    static: Splats
    """What is drawn with them and does not learn."""
    goal: Goal


@dataclass(frozen=True)
class _Descended:
    """The last step: what was seen before it, and the gradient [T, n, ...] by carried means and quaternions."""

    sheets: list[Sheet]
    of_means: Tensor
    of_quats: Tensor
    losses: list[float]
    """Before each step."""


def _descend(gaussians: Gaussians, path: Path, steps: int) -> _Descended:
    """`steps` steps, 1 or more, by the fastest way there is."""
    if splat.can_descend(gaussians.values.device) and len(path.goal.targets) == 1:
        return _descend_fused(gaussians, path, steps)
    return _descend_plain(gaussians, path, steps)


def _descend_plain(gaussians: Gaussians, path: Path, steps: int) -> _Descended:
    """Steps in torch, on any device: the reference of the fused ones."""
    descent, carriage, losses = gaussians.descent(path.rows), path.carriage, []
    for _ in range(steps):
        values = descent.values
        moving = activated(values, carriage.means(values[:, MEAN]), carriage.quats(values[:, QUAT]))
        seen = differentiate(join(path.static, moving), path.goal)
        losses.append(seen.loss)
        gradient = _tail(seen.gradient, len(path.rows))
        local = replace(
            gradient,
            means=carriage.means_gradient(gradient.means),
            quats=carriage.quats_gradient(gradient.quats),
        )
        descent.step(_to_columns(moving, local), path.rates)
    descent.end()
    return _Descended(seen.sheets, gradient.means, gradient.quats, losses)


def _descend_fused(gaussians: Gaussians, path: Path, steps: int) -> _Descended:
    """The same in one call of the compiled library, for cameras of one size."""
    rows, goal, times = path.rows, path.goal, len(path.goal.cameras)
    target = goal.targets[0]
    assert goal.backdrops is not None
    learners = splat.Learners(
        gaussians.values[rows],
        gaussians.moment1[rows],
        gaussians.moment2[rows],
        gaussians.steps[rows],
        path.rates,
        gaussians.largest[rows],
        *vars(path.carriage).values(),
    )
    static = path.static
    bystanders = splat.Bystanders(
        static.means.expand(times, -1, -1),
        static.quats.expand(times, -1, -1),
        static.scales,
        static.opacities,
        static.rgb,
    )
    aims = splat.Aims(
        torch.from_numpy(np.stack([camera.viewmat for camera in goal.cameras])).float(),
        torch.from_numpy(np.stack([camera.K for camera in goal.cameras])).float(),
        torch.stack(tuple(goal.backdrops)),
        None if goal.masks is None else torch.from_numpy(np.stack(goal.masks)),
        target.rgb,
        target.weights,
        target.depth,
        0.0 if target.depth is None else DEPTH_WEIGHT,
    )
    done = splat.descend(learners, bystanders, aims, steps, SMALLEST)
    gaussians.take(rows, learners.values, learners.moment1, learners.moment2, learners.steps)
    gaussians.refused += done.refused
    sheet = Sheet(list(range(times)), done.seen, done.alphas)
    return _Descended([sheet], done.v_means, done.v_quats, done.losses.tolist())


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


def held_pixels(observed: Sequence[Observed], moving: Splats) -> list[Bool]:
    """Per view [H, W] the pixels that a rendering is held to: where something changed, and where what moves shows.

    `moving` are the Gaussians that move, at each view's time. Behind thin or loose surfaces they shine through: a view
    in which nothing moves there must have its say too.
    """
    masks = []
    for index, one in enumerate(observed):
        means = moving.means[index].cpu().numpy()
        masks.append((grow(one.active, SKIRT_PX) | _footprint(one, means)) & one.usable)
    return masks


def _footprint(one: Observed, points: NDArray[np.floating]) -> Bool:
    """[H, W] pixels at and around the projections of points [n, 3]."""
    seen = look(one.view.camera, points)
    mask = np.zeros(one.usable.shape, bool)
    mask[seen.rows[seen.inside], seen.columns[seen.inside]] = True
    return grow(mask, 2)
