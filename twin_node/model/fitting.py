"""Gradient steps: canonical attributes of selected Gaussians, and the poses of their nodes, towards the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from twin_node.model.carriage import Bend, Carriage, carry
from twin_node.model.descending import Path, descend, diverged, rates_of, undo
from twin_node.model.gaussians import LOG_SCALE, MEAN, QUAT, RGB, WIDTH, Gaussians
from twin_node.model.motion import Motion
from twin_node.model.nodes import Poses
from twin_node.model.observation import Observed
from twin_node.model.photometric import goal_of
from twin_node.model.rendering import Rendering, Splats
from twin_node.model.rotations import quat_product
from twin_node.model.unseen import blend_weights
from twin_node.scene import Bool, View
from twin_node.scene.narrowing import WholeNarrower

REGULARITY = 1e-3
"""Weight of the field's own regulariser beside the photometric loss (4DGS: 2e-4 in space, 1e-3 in time)."""
CANONICAL_SHARE = 1.5
"""What the mean's rate is multiplied by while things move: it also makes good what the nodes' motion leaves over."""
SETTLING_S, SETTLED = 0.3, 0.3
"""Time constant in which a Gaussian finds its place on its body, s, and the share of the mean's rate that is left to it
then: with a tenth of it distances change by a third less, and pixels of a cell without depth are 0.2 dB worse."""
FIRST_RATES = torch.full((WIDTH,), 3.0)
FIRST_RATES[QUAT] = 9.0
FIRST_RATES[LOG_SCALE] = 30.0
"""What the rates per column are multiplied by at the start of the first fit, which is as good in 120 steps as in 300 at
the plain rates. Sizes go ahead: Gaussians have to meet before colours and places have made good what shows between
them, which suits the views that are fitted and no other: views from elsewhere gain 2 to 3 dB by it."""
AT_ONCE = 2
"""Steps of the first fit between two looks at which Gaussians lie before which, and how large they are."""
COARSE_PX, COARSE_SHARE = 320, 0.75
"""On a CPU images of twice that width and more take such a share of a first fit's steps in pixels of 2 x 2 of theirs
and more, down to that width. Four views of 640 x 480 are fitted in half of the time, 0.3 dB worse at first and 0.1 dB
worse within 30 sets; with as many fewer steps they are 1 dB worse. A GPU takes a second for all of it as it is."""
TOLD_PX = 1.0
"""Blend weight, summed over a camera's pixels, from which on images alone tell a Gaussian's colour. Adam's steps are as
long for what shines through others' rims by a hundredth of a pixel: without this such ground was yellow or red from
elsewhere."""
FULL_SHARE = 0.5
"""Share of all pixels that may take every step. Where more count, as after a knock on a camera, all take fewer steps,
so that no set costs much more than others; what is left the next sets make good."""


def fit_all(gaussians: Gaussians, views: Sequence[View], steps: int) -> None:
    """Fits every Gaussian, none of which moves, to one set of views.

    Rates fall to a tenth on the way. Behind the Gaussians is black, as far as the view measures. Where any view
    measures depth, what hardly shows keeps the colour that it was seeded with.
    """
    is_coarse = gaussians.values.device.type == "cpu"
    coarse_steps = int(COARSE_SHARE * steps / AT_ONCE) * AT_ONCE if is_coarse else 0
    rows = torch.nonzero(gaussians.alive)[:, 0]
    if not len(rows):
        return
    no_nodes = Poses(*(torch.zeros(len(views), 0, width, dtype=torch.float64) for width in (3, 4)))
    at_rest = carry(no_nodes, torch.full_like(rows, -1))
    alone, seeded = gaussians.standing(gaussians.values[:0]), gaussians.values[rows, RGB]
    for seen, course in ((_coarse(views), range(coarse_steps)), (views, range(coarse_steps, steps))):
        if not course:
            continue
        backdrops = [_black(view, gaussians.values) for view in seen]
        goal = goal_of(seen, [None] * len(seen), backdrops, gaussians.values.device)
        for begin in course[::AT_ONCE]:
            count = min(AT_ONCE, course.stop - begin)
            fall = 0.1 ** ((begin + (count - 1) / 2) / steps)
            rates = rates_of(gaussians.values[rows], fall) * FIRST_RATES.to(gaussians.values.device)
            descend(gaussians, Path(rows, at_rest, rates, alone, goal), count)
    if any(view.depth is not None for view in views):  # where places are guesses it costs what moves 0.3 dB
        drawn = gaussians.standing(gaussians.values[rows])
        shown = torch.stack([blend_weights(drawn, view.camera) for view in views]).amax(0)
        told = (shown / TOLD_PX).clamp_max(1)[:, None]
        gaussians.values[rows, RGB] = torch.lerp(seeded, gaussians.values[rows, RGB], told)


def _coarse(views: Sequence[View]) -> list[View]:
    """The views in larger pixels, where they are wide."""
    narrower = WholeNarrower()
    return [narrower.down_to(view, COARSE_PX) for view in views]


def _black(view: View, like: Tensor) -> Tensor:
    """[H, W, 4] colour and depth behind all: where a Gaussian lets light through, its depth alone is compared."""
    backdrop = like.new_zeros(*view.rgb.shape[:2], 4)
    if view.depth is not None:
        backdrop[..., 3] = torch.from_numpy(np.ascontiguousarray(view.depth)).to(like.device)
    return backdrop


def fit_moving(
    gaussians: Gaussians,
    motion: Motion,
    observed: Sequence[Observed],
    poses: Poses,
    masks: Sequence[Bool],
    static: Splats,
    steps: int,
    learning_rate: float,
) -> Fitted:
    """A few steps on the Gaussians that move, before the backgrounds, inside `masks` [H, W].

    Each view is fitted at its own time, for which `poses` holds the nodes'. `static` is what can stand before what
    moves and is not touched. Where a node is DEFORMABLE the field learns along, from the last step. Where more than
    `FULL_SHARE` of the pixels count there are fewer steps. Steps that make the images worse are undone.
    """
    rows = gaussians.moving_rows
    if not len(rows) or not steps:
        return Fitted([], diverged=False)
    stamps = motion.stamps([one.offset_s for one in observed])
    views = [one.view for one in observed]
    backdrops = [one.background.backdrop for one in observed]
    goal = goal_of(views, masks, backdrops, gaussians.values.device, [one.rgb for one in observed])
    values = gaussians.values.index_select(0, rows)
    rates = rates_of(values, learning_rate)
    rates[:, MEAN] *= CANONICAL_SHARE * _looseness(gaussians, rows, motion.nodes.stamp)[:, None]
    rigid = carry(poses, gaussians.nodes.index_select(0, rows))
    bend = motion.bend(gaussians.population(rows, motion.nodes), stamps) if motion.bends else None
    path = Path(rows, rigid if bend is None else _detached(rigid.bent(bend)), rates, static, goal)
    affordable = affordable_steps(steps, masks)
    last = descend(gaussians, path, affordable if bend is None else max(affordable - 1, 1))
    if diverged(last.losses):
        undo(gaussians, rows, values)
        return Fitted([], diverged=True)
    if bend is not None:
        values = gaussians.values[rows]
        last = descend(gaussians, path, 1)
        of_means = path.carriage.means_gradient(last.of_means)
        _learn_field(motion, bend, values, of_means, rigid.quats_gradient(last.of_quats))
    return Fitted(last.seen, diverged=False)


@dataclass(frozen=True)
class Fitted:
    """What a few steps have led to."""

    renderings: list[Rendering]
    """What the views saw before the last step; empty where nothing was learned."""
    diverged: bool
    """The steps made the images worse and were undone: the next ones should be smaller."""


def affordable_steps(steps: int, masks: Sequence[Bool]) -> int:
    """How many of `steps`, 1 or more, the pixels inside `masks` [H, W] may take; by their count, never by a clock."""
    share = sum(int(np.count_nonzero(mask)) for mask in masks) / sum(mask.size for mask in masks)
    return max(min(steps, int(steps * FULL_SHARE / max(share, FULL_SHARE))), 1)


def _looseness(gaussians: Gaussians, rows: Tensor, stamp: int) -> Tensor:
    """[n] share of their rate at which the means of `rows` [n] still move at `stamp` (ns) in the frames of their nodes.

    The place of a newborn is a guess. Once it is learnt, motion is the node's: what is rigid must not creep.
    """
    age_s = gaussians.births.index_select(0, rows).neg_().add_(stamp).float().mul_(1e-9)
    loose = age_s.div_(-SETTLING_S).exp_().mul_(1 - SETTLED).add_(SETTLED)
    return torch.where(gaussians.nodes.index_select(0, rows) >= 0, loose, 1.0)


def _detached(carriage: Carriage) -> Carriage:
    return Carriage(*(field.detach() for field in vars(carriage).values()))


def _learn_field(motion: Motion, bend: Bend, values: Tensor, of_means: Tensor, of_quats: Tensor) -> None:
    """One step of the field, from the gradients [T, n, ...] with respect to bent means and quaternions."""
    turned = quat_product(bend.turns, values[bend.chosen, QUAT])
    pulled = (bend.offsets * of_means[:, bend.chosen]).sum() + (turned * of_quats[:, bend.chosen]).sum()
    torch.autograd.backward(pulled)  # not as two gradients: see `least_squares`
    torch.autograd.backward(REGULARITY * motion.field.regularity())
    motion.descend()
