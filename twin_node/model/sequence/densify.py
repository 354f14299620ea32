"""Adaptive density control of 3DGS (Kerbl et al., TOG 2023, section 5.2): clone, split, prune."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from twin_node.model.rotations import rotate
from twin_node.model.sequence.canonical import CanonicalGaussians, Offspring
from twin_node.model.sequence.parameters import DensifyParameters
from twin_node.scene import Camera

SHRINK = 1.6
"""How much smaller the two halves of a split Gaussian are, as published."""


class PositionGradients:
    """Mean gradient of each Gaussian's position in the images that showed it, in half widths."""

    def __init__(self, count: int, device: torch.device) -> None:
        self.sums = torch.zeros(count, device=device)
        """[N] of the gradients' lengths."""
        self.counts = torch.zeros(count, device=device)
        """[N] images that showed the Gaussian."""

    def add(self, camera: Camera, means: Tensor, gradient: Tensor, radii: Tensor) -> None:
        """Takes in one image: the gradient [N, 3] with respect to means [N, 3], and radii [N, 2] in pixels.

        A step of 1 px across the ray at depth z is one of z / f in space: the gradient per pixel is the lateral part of
        the one in space times z / f. What the projection's own shape adds is left out.
        """
        viewmat = torch.as_tensor(camera.viewmat, dtype=torch.float32, device=means.device)
        lateral = gradient @ viewmat[:2, :3].T
        depth = (means.detach() @ viewmat[2, :3] + viewmat[2, 3]).clamp_min(0)
        seen = (radii > 0).all(-1)
        half_widths = depth / float(camera.K[0, 0]) * (camera.width / 2)
        self.sums += torch.where(seen, lateral.norm(dim=-1) * half_widths, 0.0)
        self.counts += seen

    @property
    def mean(self) -> Tensor:
        """[N] zero for Gaussians that no image has shown."""
        return self.sums / self.counts.clamp_min(1)


def densify(
    gaussians: CanonicalGaussians,
    gradients: PositionGradients,
    parameters: DensifyParameters,
    extent: float,
    most: int,
    random: torch.Generator,
) -> None:
    """Clones small Gaussians that the images pull at, splits large ones, and prunes the faint and the huge.

    Where there is no room for all (`most`), those go first that are pulled at hardest.
    """
    pull = gradients.mean
    room = max(most - len(gaussians), 0)
    wanted = torch.nonzero(pull > parameters.gradient)[:, 0]
    wanted = wanted[pull[wanted].argsort(descending=True, stable=True)][:room].sort().values
    size = gaussians.log_scales.detach()[wanted].exp().amax(-1)
    cloned, parents = wanted[size <= parameters.small * extent], wanted[size > parameters.small * extent]
    before = len(gaussians)
    gaussians.add(_clones(gaussians, cloned))
    gaussians.add(_halves(gaussians, parents, random))
    stay = torch.ones(len(gaussians), dtype=torch.bool, device=pull.device)
    stay[:before][parents] = False
    largest = gaussians.log_scales.detach().amax(-1)
    faintest = math.log(parameters.faintest / (1 - parameters.faintest))
    stay &= (gaussians.logits.detach() >= faintest) & (largest <= math.log(parameters.largest * extent))
    if bool(stay.any()):
        gaussians.keep(torch.nonzero(stay)[:, 0])


def _clones(gaussians: CanonicalGaussians, rows: Tensor) -> Offspring:
    return Offspring(rows, gaussians.means.detach()[rows], gaussians.log_scales.detach()[rows])


def _halves(gaussians: CanonicalGaussians, rows: Tensor, random: torch.Generator) -> Offspring:
    """Two smaller ones for each of `rows`, drawn from it."""
    twice = rows.repeat(2)
    log_scales = gaussians.log_scales.detach()[twice]
    quats = torch.nn.functional.normalize(gaussians.quats.detach()[twice], dim=-1)
    drawn = torch.randn(len(twice), 3, generator=random).to(log_scales.device) * log_scales.exp()
    return Offspring(twice, gaussians.means.detach()[twice] + rotate(quats, drawn), log_scales - math.log(SHRINK))
