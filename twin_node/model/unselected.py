"""All Gaussians descending at once on whole images: what the selection of those that move is compared with."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from twin_node.model.carriage import carry
from twin_node.model.descending import Path, descend, diverged, rates_of, undo
from twin_node.model.fitting import Fitted
from twin_node.model.gaussians import Gaussians
from twin_node.model.motion import Motion
from twin_node.model.nodes import Poses
from twin_node.model.observation import Observed
from twin_node.model.photometric import goal_of


def fit_unselected(
    gaussians: Gaussians,
    motion: Motion,
    observed: Sequence[Observed],
    poses: Poses,
    steps: int,
    learning_rate: float,
) -> Fitted:
    """As `fitting.fit_moving`, but what stands still learns with what moves, and every usable pixel counts.

    The arm's links are drawn and do not learn. What bends does so as the field has it by now; the field does not learn.
    """
    rows = torch.cat([gaussians.static_rows, gaussians.moving_rows])
    if not len(rows) or not steps:
        return Fitted([], diverged=False)
    stamps, device = motion.stamps([one.offset_s for one in observed]), gaussians.values.device
    views, masks = [one.view for one in observed], [one.usable for one in observed]
    backdrops = []
    for one in observed:
        behind = torch.zeros(*one.usable.shape, 4, device=device)
        behind[..., 3] = torch.from_numpy(one.background.surface).to(behind)
        backdrops.append(behind)
    with torch.no_grad():
        arm = motion.place(gaussians, gaussians.robot_rows, poses, stamps)
        carriage = carry(poses, gaussians.nodes[rows])
        bend = motion.bend(gaussians.population(rows, motion.nodes), stamps)
        carriage = carriage if bend is None else carriage.bent(bend)
    values = gaussians.values[rows]
    goal = goal_of(views, masks, backdrops, device)
    done = descend(gaussians, Path(rows, carriage, rates_of(values, learning_rate), arm, goal), steps)
    if diverged(done.losses):
        undo(gaussians, rows, values)
        return Fitted([], diverged=True)
    return Fitted(done.seen, diverged=False)
