"""Whole-sequence training, 4DGS as published (Wu et al., CVPR 2024): a static stage, then a stage with the field."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.devices import usable_device
from twin_node.model.ply import StoredGaussians
from twin_node.model.sequence.canonical import CanonicalGaussians
from twin_node.model.sequence.densify import PositionGradients, densify
from twin_node.model.sequence.field import Box, SequenceField
from twin_node.model.sequence.hash_mlp import SequenceHashMlp
from twin_node.model.sequence.hex_plane import SequenceHexPlane
from twin_node.model.sequence.parameters import TrainParameters
from twin_node.model.sequence.recording import Recording
from twin_node.model.sequence.seeding import box_around, start_gaussians
from twin_node.model.sequence.sequence_model import SequenceModel, Span, draw


def make_field(box: Box, steps: int, parameters: TrainParameters) -> SequenceField | None:
    """The field of a method, for a sequence of `steps` time steps, on the box's device; None for the static one."""
    device = box.lower.device
    if parameters.method == "hexplane":
        return SequenceHexPlane(box, steps, parameters.hexplane, parameters.seed).to(device)
    if parameters.method == "hash":
        return SequenceHashMlp(box, steps, parameters.hash, parameters.seed).to(device)
    return None


class Trainer:
    """Fits a `SequenceModel` to a recording, one step at a time.

    What a step draws depends on the seed and its number alone: a run that was stopped goes on as if it had not been.
    """

    def __init__(
        self,
        recording: Recording,
        parameters: TrainParameters | None = None,
        start: StoredGaussians | None = None,
        box: Box | None = None,
    ) -> None:
        """`start`: Gaussians to begin with, and `box` that the field spans; by default found in the recording.

        Raises `ModelError` for a recording too far from the origin, and for a device that is not there.
        """
        recording.check_places()
        self.recording = recording
        self.parameters = p = parameters or TrainParameters()
        self.extent = recording.extent
        if start is None:
            start = start_gaussians(recording, p.start_gaussians, p.degree, p.seed)
        self._device = usable_device(p.device)
        self.box = (box or box_around(recording, start)).to(self._device)
        gaussians = CanonicalGaussians(start, p.rates, self.extent, self._device)
        field = make_field(self.box, recording.steps, p)
        self.model = SequenceModel(gaussians, field, Span(recording.first, recording.last), recording.background)
        self.gradients = PositionGradients(len(gaussians), self._device)
        self.field_optimizer = None if field is None else self._field_optimizer(field)
        self.step = 0
        """Steps taken, of both stages."""
        self.refused = 0
        """Steps since the start (or the checkpoint) whose gradients were not finite and were therefore not followed."""

    @property
    def finished(self) -> bool:
        """Whether all steps have been taken."""
        return self.step >= self.parameters.all_steps

    @property
    def moving(self) -> bool:
        """Whether the field takes part."""
        return self.model.field is not None and self.step >= self.parameters.coarse_steps

    def advance(self) -> float:
        """Takes one step and returns its image loss."""
        self._schedule()
        loss = self._descend(self._batch())
        self.step += 1
        self._control_density()
        return loss

    def _batch(self) -> list[int]:
        """Indices of the images of this step: each epoch runs through all of them in an order of its own."""
        count, size = len(self.recording.train), self.parameters.batch
        chosen = []
        for position in range(self.step * size, (self.step + 1) * size):
            order = torch.randperm(count, generator=self._random(1, position // count))
            chosen.append(int(order[position % count]))
        return chosen

    def _descend(self, batch: list[int]) -> float:
        views = [self.recording.train[index] for index in batch]
        moved = self.model.at([view.stamp for view in views], self.moving)
        means = [moved.means[row] for row in range(len(views))]
        total = moved.opacities.new_zeros(())
        radii = []
        for row, (index, view) in enumerate(zip(batch, views, strict=True)):
            if means[row].requires_grad:
                means[row].retain_grad()
            drawn = draw(moved, row, view.camera, self.recording.background, means[row])
            radii.append(drawn.radii)
            total = total + self._loss(drawn.rgb, index) / len(views)
        whole = total
        if self.moving and self.model.field is not None:
            whole = total + self.model.field.regularity(self._random(2, self.step))
        torch.autograd.backward(whole)
        for view, placed, drawn_radii in zip(views, means, radii, strict=True):
            if placed.grad is not None:
                pull = torch.nan_to_num(placed.grad * len(views), 0.0, 0.0, 0.0)
                self.gradients.add(view.camera, placed, pull, drawn_radii)
        self._apply()
        return float(total.detach())

    def _loss(self, rgb: Tensor, index: int) -> Tensor:
        p = self.parameters
        view = self.recording.train[index]
        target = torch.from_numpy(np.ascontiguousarray(view.rgb)).to(self._device).float() / 255
        weights = None if view.valid is None else torch.from_numpy(np.ascontiguousarray(view.valid)).to(self._device)
        return splat.image_loss(rgb, target, weights=weights, l1=p.l1, ssim=p.ssim)

    def _apply(self) -> None:
        """Follows the gradients that were just computed, if all of them are finite."""
        taking_part = (self.model.gaussians.optimizer, self.field_optimizer if self.moving else None)
        optimizers = [optimizer for optimizer in taking_part if optimizer is not None]
        groups = [group for optimizer in optimizers for group in optimizer.param_groups]
        gradients = [p.grad for group in groups for p in group["params"] if p.grad is not None]
        finite = all(bool(torch.isfinite(gradient).all()) for gradient in gradients)
        self.refused += not finite
        for optimizer in optimizers:
            if finite:
                optimizer.step()
            optimizer.zero_grad(set_to_none=True)

    def _schedule(self) -> None:
        """Rates fall exponentially: the means' over both stages, the field's over its own."""
        p, rates = self.parameters, self.parameters.rates
        self.model.gaussians.schedule(self.step / p.all_steps)
        if self.field_optimizer is not None:
            share = max(self.step - p.coarse_steps, 0) / p.steps
            grid, decoder = self.field_optimizer.param_groups
            grid["lr"] = rates.grid ** (1 - share) * rates.grid_final**share
            decoder["lr"] = rates.decoder ** (1 - share) * rates.decoder_final**share

    def _control_density(self) -> None:
        d, total = self.parameters.densify, self.parameters.all_steps
        if not d.begin * total <= self.step <= d.end * total:
            return
        gaussians = self.model.gaussians
        if self.step % d.interval == 0:
            random = self._random(3, self.step)
            densify(gaussians, self.gradients, d, self.extent, self.parameters.most_gaussians, random)
            self.gradients = PositionGradients(len(gaussians), self._device)
        if self.step % d.reset_interval == 0:
            gaussians.cap_opacity(d.reset_opacity)

    def _field_optimizer(self, field: SequenceField) -> torch.optim.Adam:
        groups = [{"params": field.grids()}, {"params": field.decoder()}]
        return torch.optim.Adam(groups, eps=1e-15, fused=True)

    def _random(self, purpose: int, number: int) -> torch.Generator:
        """Draws that depend on the seed, what they are for, and a number alone."""
        mixed = np.random.SeedSequence([self.parameters.seed, purpose, number])
        return torch.Generator().manual_seed(int(mixed.generate_state(1)[0]))  # torch takes no more than 32 bits
