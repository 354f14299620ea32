"""Scenes for the tests of the rasteriser, and how close two results have to be."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

Renderer = Callable[..., tuple[Tensor, Tensor, Any]]

INPUTS = ("means", "quats", "scales", "opacities", "colors", "viewmats")
"""What gradients reach."""


@dataclass(frozen=True)
class Case:
    """One call of `rasterize`: its tensors, image size and options."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    viewmats: Tensor
    Ks: Tensor
    width: int
    height: int
    options: dict[str, Any]

    def with_options(self, **options: Any) -> Case:
        return replace(self, options={**self.options, **options})

    def to(self, dtype: torch.dtype) -> Case:
        """The same with other floats."""
        cast = {name: value.to(dtype) for name, value in vars(self).items() if isinstance(value, Tensor)}
        options = {
            name: value.to(dtype) if isinstance(value, Tensor) and value.is_floating_point() else value
            for name, value in self.options.items()
        }
        return replace(self, **cast, options=options)

    def render(self, renderer: Renderer) -> tuple[Tensor, Tensor, Any]:
        tensors = (self.means, self.quats, self.scales, self.opacities, self.colors, self.viewmats, self.Ks)
        return renderer(*tensors, self.width, self.height, **self.options)


@dataclass(frozen=True)
class Result:
    """Images and gradients of a random linear function of them."""

    renders: Tensor
    alphas: Tensor
    meta: Any
    gradients: dict[str, Tensor]


def look_at(eye: Tensor, target: Tensor) -> Tensor:
    """World-to-camera matrix [4, 4] of a camera at `eye` that looks at `target`, z forward, y down."""
    forward = torch.nn.functional.normalize(target - eye, dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, torch.tensor([0.0, 0.0, 1.0])), dim=0)
    rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
    view = torch.eye(4)
    view[:3, :3] = rotation
    view[:3, 3] = -rotation @ eye
    return view


def make_case(
    count: int = 300,
    width: int = 48,
    height: int = 32,
    cameras: int = 2,
    channels: int | None = None,
    sh_degree: int = 0,
    scale: float = 0.12,
    seed: int = 0,
    **options: Any,
) -> Case:
    """Anisotropic Gaussians in a box of 2 m, some behind the cameras, seen from around; N-D colours with `channels`."""
    random = torch.Generator().manual_seed(seed)
    means = 2 * torch.rand(count, 3, generator=random) - 1
    means[: count // 20] *= 4  # beside and behind the cameras
    angles = torch.arange(cameras) * 2.1 + 0.3
    eyes = torch.stack([2.5 * angles.cos(), 2.5 * angles.sin(), 0.6 + 0.2 * angles], dim=-1)
    focal = 0.7 * width / math.tan(0.6)
    K = torch.tensor([[focal, 0, width / 2 + 1.3], [0, 1.1 * focal, height / 2 - 0.7], [0, 0, 1]])
    if channels is None:
        options["sh_degree"] = sh_degree
        colors = 0.4 * torch.randn(count, (sh_degree + 1) ** 2, 3, generator=random)
    else:
        colors = torch.rand(count, channels, generator=random)
    return Case(
        means=means,
        quats=torch.randn(count, 4, generator=random),
        scales=scale * torch.exp(0.6 * torch.randn(count, 3, generator=random)),
        opacities=torch.sigmoid(1.8 * torch.randn(count, generator=random) + 0.5),
        colors=colors,
        viewmats=torch.stack([look_at(eye, torch.zeros(3)) for eye in eyes]),
        Ks=K.expand(cameras, 3, 3).contiguous(),
        width=width,
        height=height,
        options=options,
    )


def differentiate(renderer: Renderer, case: Case) -> Result:
    """Renders and sends random weights, the same for every renderer, back."""
    leaves = {name: getattr(case, name).clone().requires_grad_() for name in INPUTS}
    renders, alphas, meta = replace(case, **leaves).render(renderer)
    random = torch.Generator().manual_seed(1)
    weights = [torch.randn(t.shape, generator=random).to(t) for t in (renders, alphas)]
    ((renders * weights[0]).sum() + (alphas * weights[1]).sum()).backward()
    gradients = {name: torch.zeros_like(t) if t.grad is None else t.grad for name, t in leaves.items()}
    return Result(renders.detach(), alphas.detach(), meta, gradients)


def assert_close(found: Result, expected: Result, image: float = 1e-4, gradient: float = 1e-4) -> None:
    """Images agree but for the odd pixel that lies on a threshold, gradients in the relative L2 norm.

    An alpha on 1/255, or a transmittance on 1e-4, can fall on either side in float32; that pixel then moves by up to a
    255th of the colour.
    """
    for name in ("renders", "alphas"):
        ours, truth = getattr(found, name).double(), getattr(expected, name).double()
        error = (ours - truth).abs().flatten()
        allowed = max(1, error.numel() // 1000)
        assert int((error > image).sum()) <= allowed, f"{name}: {int((error > image).sum())} of {error.numel()} values"
        assert float(error.max()) <= truth.abs().max() / 255 + image, f"{name}: off by {float(error.max())}"
    for name, truth in expected.gradients.items():
        error = (found.gradients[name].double() - truth.double()).norm()
        assert float(error) <= gradient * float(truth.double().norm()) + 1e-9, f"{name}: {float(error / truth.norm())}"
