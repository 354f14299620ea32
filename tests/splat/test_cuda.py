"""gsplat on a CUDA device against the plain version: the same comparison as for the compiled CPU backend."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from splat_scenes import Case, assert_close, differentiate, make_case

from twin_node.splat import SplatError, cuda, rasterize, rasterize_reference
from twin_node.splat.arguments import Gaussians, Options, Views, check_shapes
from twin_node.splat.cuda import gsplat_module

needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here: gsplat is not compared")


def on_cuda(case: Case) -> Case:
    def move(values: dict[str, object]) -> dict[str, object]:
        return {k: v.cuda() if isinstance(v, torch.Tensor) else v for k, v in values.items()}

    fields = move(vars(case))
    return replace(case, **{**fields, "options": move(case.options)})


@needs_cuda
@pytest.mark.parametrize(
    "case",
    [
        make_case(sh_degree=0, render_mode="RGB+D", backgrounds=torch.rand(2, 3)),
        make_case(sh_degree=3, render_mode="RGB+ED", rasterize_mode="antialiased"),
        make_case(channels=5, width=37, height=29),
        make_case(channels=3, render_mode="ED", pixel_mask=torch.rand(2, 32, 48) > 0.5),
    ],
)
def test_agrees_with_the_plain_version(case: Case):
    expected = differentiate(rasterize_reference, case.to(torch.float64))
    found = differentiate(rasterize, on_cuda(case))
    cpu = replace(
        found,
        renders=found.renders.cpu(),
        alphas=found.alphas.cpu(),
        gradients={name: gradient.cpu() for name, gradient in found.gradients.items()},
    )
    assert_close(cpu, expected, image=2e-4, gradient=1e-3)


def pretended(
    *tensors: torch.Tensor, packed: bool, **options: Any
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """`gsplat.rasterization` on the CPU."""
    renders, alphas, meta = rasterize_reference(*tensors, **options)
    return renders, alphas, vars(meta)


def test_pixels_outside_the_mask_send_back_no_gradient(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cuda, "gsplat_module", lambda: SimpleNamespace(rasterization=pretended))
    case = make_case(channels=3)
    mask = torch.rand(2, 32, 48, generator=torch.Generator().manual_seed(0)) > 0.5
    backgrounds = torch.full((2, 3), 0.5, requires_grad=True)
    views = Views(case.viewmats, case.Ks, case.width, case.height, backgrounds, mask)
    gaussians = Gaussians(case.means, case.quats, case.scales, case.opacities, case.colors)
    found = cuda.render_gsplat(check_shapes(gaussians, views, Options(render_mode="RGB+D")))
    expected, _, _ = case.with_options(backgrounds=backgrounds, pixel_mask=mask, render_mode="RGB+D").render(rasterize)
    torch.testing.assert_close(found.renders, expected, atol=1e-4, rtol=1e-4)
    ours, theirs = (torch.autograd.grad(renders.sum(), backgrounds)[0] for renders in (found.renders, expected))
    torch.testing.assert_close(ours, theirs)


@pytest.mark.skipif(torch.cuda.is_available(), reason="CUDA is here")
def test_without_cuda_the_error_says_what_is_missing():
    with pytest.raises(SplatError, match="missing: a CUDA device and a CUDA build of torch"):
        gsplat_module()
