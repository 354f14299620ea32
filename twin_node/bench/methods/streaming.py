"""After 3DGStream (Sun et al., CVPR 2024): each set warps the Gaussians of the one before, then adds some of its own.

Stage one learns a fresh hash grid over space and its heads, a transformation of every Gaussian; the warp is kept. Stage
two clones what the images still pull at and fits the clones alone; they live for one set.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from twin_node import splat
from twin_node.bench.methods.following import Population, follow_populations
from twin_node.bench.methods.protocol import Budget, Fitted, Progress
from twin_node.bench.methods.whole_sequence import train_parameters
from twin_node.model.ply import StoredGaussians
from twin_node.model.sequence import Box, Recording, Trainer
from twin_node.model.sequence.baking import bake_steps
from twin_node.model.sequence.canonical import CanonicalGaussians, Offspring
from twin_node.model.sequence.densify import PositionGradients
from twin_node.model.sequence.field import MotionHeads, moved_quats
from twin_node.model.sequence.hash_mlp import HashGrid
from twin_node.model.sequence.parameters import RateParameters
from twin_node.model.sequence.sequence_model import MovedGaussians, draw
from twin_node.scene import FrameSet, View

FIRST_STEPS = 10
"""Steps on the first set, in units of those of a stage: 1500 of 150 as published, the larger part."""
WARP_RATE = 2e-3
"""Of grid and heads, as published."""
PULL = 1.5e-4
"""Gradient above which a Gaussian is cloned, as published."""
MOST_CLONES = 400
BIRTH_RATES = RateParameters(
    means=2.4e-3, means_final=2.4e-3, quats=1.5e-2, log_scales=7.5e-2, logits=0.75, colours=3.75e-2
)
"""Fifteen times those of 3DGS, as published."""
RESOLUTIONS = tuple((cells,) * 3 for cells in (8, 12, 18, 27, 40, 60))
FEATURES, ENTRIES, HIDDEN = 4, 2**14, 64


@dataclass(frozen=True)
class Carried:
    """Gaussians between two sets."""

    means: Tensor
    """[N, 3] m."""
    quats: Tensor
    """[N, 4] w, x, y, z."""
    log_scales: Tensor
    """[N, 3] log of metres."""
    logits: Tensor
    """[N] logit of the opacity."""
    sh: Tensor
    """[N, K, 3] harmonic coefficients."""

    @classmethod
    def of(cls, gaussians: CanonicalGaussians) -> Carried:
        """Gaussians under training, as they are."""
        g = gaussians
        return cls(*(value.detach().clone() for value in (g.means, g.quats, g.log_scales, g.logits, g.sh)))

    def with_more(self, other: Carried) -> Carried:
        """Both; those of `other` last."""
        return Carried(*(torch.cat([a, b]) for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))

    def placed(self) -> MovedGaussians:
        """Ready to be drawn, one time."""
        quats = torch.nn.functional.normalize(self.quats, dim=-1)
        return MovedGaussians(
            self.means[None], quats[None], self.log_scales.exp()[None], self.logits.sigmoid(), self.sh
        )

    def stored(self) -> StoredGaussians:
        """As files and optimisers hold them."""
        return StoredGaussians(*(value.numpy() for value in vars(self).values()))


class Warp(torch.nn.Module):
    """A rigid motion of every point, from a hash grid; none at all at the start."""

    def __init__(self, box: Box, seed: int) -> None:
        super().__init__()
        random = torch.Generator().manual_seed(seed)
        self.box = box
        self.grid = HashGrid(RESOLUTIONS, FEATURES, ENTRIES, random)
        self.heads = MotionHeads(self.grid.width, HIDDEN, box.reach, random)

    def forward(self, still: Carried) -> Carried:
        """Gaussians warped; sizes, opacities and colours stay."""
        motion = self.heads(self.grid(self.box.unit(still.means))[None])
        return replace(still, means=still.means + motion.offsets[0], quats=moved_quats(still.quats, motion.turns)[0])


def fit_streaming(recording: Recording, budget: Budget, progress: Progress) -> Fitted:
    """Every set in turn."""
    sets = recording.sets()
    alone = Recording(recording.name, sets[0].views, background=recording.background)
    trainer = Trainer(alone, train_parameters(budget, "static", FIRST_STEPS * budget.stream_steps))
    while not trainer.finished:
        trainer.advance()
    progress(1 / len(sets))
    base = Carried.of(trainer.model.gaussians)
    steps, bases, bytes_kept = [base.placed()], [base], 4 * trainer.model.parameters_count
    parameters = 0
    for index, one in enumerate(sets[1:], 1):
        warp = Warp(trainer.box, budget.seed + index)
        base = _warp(warp, base, one, recording, budget)
        born = _births(base, one, recording, budget, trainer.extent)
        steps.append(base.with_more(born).placed())
        bases.append(base)
        parameters = sum(p.numel() for p in warp.parameters()) + sum(value.numel() for value in vars(born).values())
        bytes_kept += 4 * parameters
        progress((index + 1) / len(sets))
    baked = bake_steps([one.stamp for one in sets], steps, recording.background, recording.cameras)
    ids = np.arange(len(base.means))

    def population(step: int) -> Population:
        at = bases[step]
        return Population(ids, at.means.double().numpy(), at.logits.sigmoid().double().numpy())

    notes = {"bytes_per_set": float(4 * parameters)}
    return Fitted(baked.render, follow_populations(len(sets), population), bytes_kept // 4, bytes_kept, notes)


def _warp(warp: Warp, base: Carried, one: FrameSet, recording: Recording, budget: Budget) -> Carried:
    """Stage one: the warp alone learns, one image per step, all in turn."""
    optimizer = torch.optim.Adam(warp.parameters(), lr=WARP_RATE, eps=1e-15, fused=True)
    for step in range(budget.stream_steps):
        view = one.views[step % len(one.views)]
        loss = _image_loss(draw(warp(base).placed(), 0, view.camera, recording.background).rgb, view)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
    with torch.no_grad():
        warped: Carried = warp(base)
    return warped


def _births(base: Carried, one: FrameSet, recording: Recording, budget: Budget, extent: float) -> Carried:
    """Stage two: clones of the Gaussians that the images pull at hardest, fitted while all others stand."""
    gaussians = CanonicalGaussians(base.stored(), BIRTH_RATES, extent, base.means.device)
    pull = _pull(base, one, recording)
    rows = torch.nonzero(pull > PULL)[:, 0]
    rows = rows[pull[rows].argsort(descending=True, stable=True)][:MOST_CLONES]
    gaussians.add(Offspring(rows, base.means[rows], base.log_scales[rows]))
    gaussians.keep(torch.arange(len(base.means), len(gaussians)))
    for step in range(budget.stream_steps if len(rows) else 0):
        view = one.views[step % len(one.views)]
        born = Carried(gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.logits, gaussians.sh)
        loss = _image_loss(draw(base.with_more(born).placed(), 0, view.camera, recording.background).rgb, view)
        gaussians.optimizer.zero_grad()
        torch.autograd.backward(loss)
        gaussians.optimizer.step()
    return Carried.of(gaussians)


def _pull(base: Carried, one: FrameSet, recording: Recording) -> Tensor:
    """[N] mean gradient of the Gaussians' positions in the images of a set."""
    gradients = PositionGradients(len(base.means), base.means.device)
    for view in one.views:
        means = base.means.clone().requires_grad_()
        drawn = draw(base.placed(), 0, view.camera, recording.background, means)
        torch.autograd.backward(_image_loss(drawn.rgb, view))
        assert means.grad is not None
        gradients.add(view.camera, means, means.grad, drawn.radii)
    return gradients.mean


def _image_loss(rgb: Tensor, view: View) -> Tensor:
    weights = None if view.valid is None else torch.from_numpy(view.valid)
    return splat.image_loss(rgb, torch.from_numpy(view.rgb).float() / 255, weights=weights)
