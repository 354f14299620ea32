"""Steps of Adam on some of the Gaussians that a scene is drawn from: compiled where that is possible, else in torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.carriage import Carriage
from twin_node.model.gaussians import LOG_SCALE, LOGIT, MEAN, QUAT, QUICK, RGB, SMALLEST, WIDTH, Gaussians, activated
from twin_node.model.photometric import DEPTH_WEIGHT, Goal, differentiate
from twin_node.model.rendering import Rendering, Sheet, Splats, join

WORSE, WORSE_FLOOR = 1.1, 1e-3
"""Times its value before the first step, plus so much, that the loss may have before the last one. Steps that are taken
well lower it by a sixth, at worst by a twentieth; what steps too long throw out of sight costs a tenth to a third more,
no more than if it had never been there."""
RATES = torch.zeros(WIDTH)
RATES[MEAN] = 0.08
RATES[QUAT] = 5e-3
RATES[LOG_SCALE] = 1.5e-2
RATES[LOGIT] = 5e-2
RATES[RGB] = 8e-3
"""Adam's rate per column; that of the mean is in units of the Gaussian's own size, so that no scene scale is needed."""


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
    decays: splat.Decays = QUICK


@dataclass(frozen=True)
class Descended:
    """The last step: what each view saw before it, and the gradient [T, n, ...] by carried means and quaternions."""

    seen: list[Rendering]
    of_means: Tensor
    of_quats: Tensor
    losses: list[float]
    """Before each step."""


def diverged(losses: Sequence[float]) -> bool:
    """Whether steps have made the images worse, by the `losses` before each; noise and births may do so a little."""
    return not losses[-1] <= WORSE * losses[0] + WORSE_FLOOR


def undo(gaussians: Gaussians, rows: Tensor, values: Tensor) -> None:
    """Gives `rows` [n] their `values` [n, 14] back, and no memory of the steps that led away from them."""
    nothing = torch.zeros_like(values)
    gaussians.take(rows, values, nothing, nothing, torch.zeros_like(gaussians.steps[rows]))


def descend(gaussians: Gaussians, path: Path, steps: int) -> Descended:
    """`steps` steps, 1 or more, by the fastest way there is."""
    if splat.can_descend(gaussians.values.device):
        return descend_fused(gaussians, path, steps)
    return descend_reference(gaussians, path, steps)


def descend_reference(gaussians: Gaussians, path: Path, steps: int) -> Descended:
    """Steps in torch, on any device: the reference of the fused ones."""
    descent, carriage, losses = gaussians.descent(path.rows, path.decays), path.carriage, []
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
        descent.step(to_columns(moving, local), path.rates)
    descent.end()
    return Descended(path.goal.own(seen.sheet), gradient.means, gradient.quats, torch.stack(losses).tolist())


def descend_fused(gaussians: Gaussians, path: Path, steps: int) -> Descended:
    """The same in one call of `splat.descend`."""
    rows, shots, target = path.rows, path.goal.shots, path.goal.targets
    times = len(shots.Ks)
    assert shots.backdrop is not None
    learners = splat.Learners(
        rows,
        gaussians.values,
        gaussians.moment1,
        gaussians.moment2,
        gaussians.steps,
        gaussians.largest,
        path.rates,
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
        shots.viewmats,
        shots.Ks,
        shots.backdrop,
        shots.masks,
        target.rgb,
        target.weights,
        target.depth,
        0.0 if target.depth is None else DEPTH_WEIGHT,
    )
    done = splat.descend(learners, bystanders, aims, splat.Course(steps, SMALLEST, path.decays))
    gaussians.refused += done.refused
    return Descended(path.goal.own(Sheet(done.seen, done.alphas)), done.v_means, done.v_quats, done.losses.tolist())


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


def to_columns(splats: Splats, gradient: Splats) -> Tensor:
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


def rates_of(values: Tensor, factor: float) -> Tensor:
    """[n, 14] Adam's rates of Gaussians `values` [n, 14]."""
    rates = (RATES.to(values.device) * factor).expand(len(values), -1).contiguous()
    x, y, z = values[:, LOG_SCALE].contiguous().exp().unbind(1)  # a mean over rows of three takes five times as long
    rates[:, MEAN] *= ((x + y + z) / 3)[:, None]
    return rates
