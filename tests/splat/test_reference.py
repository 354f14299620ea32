"""The plain rasteriser, reference of the others, against closed forms, numeric gradients and gsplat's torch code."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from splat_scenes import INPUTS, differentiate, make_case
from torch import Tensor

from twin_node.splat import rasterize_reference
from twin_node.splat.reference import harmonics


def one_gaussian(**options: object) -> tuple[Tensor, Tensor]:
    """A round Gaussian 2 m ahead at the centre of pixel (4, 3), focal length 10 px."""
    tensors = {
        "means": torch.tensor([[0.0, 0.0, 2.0]]),
        "quats": torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        "scales": torch.full((1, 3), 0.3),
        "opacities": torch.tensor([0.6]),
        "colors": torch.tensor([[0.2, 0.5, 0.9]]),
        "viewmats": torch.eye(4)[None],
        "Ks": torch.tensor([[[10.0, 0, 4.5], [0, 10.0, 3.5], [0, 0, 1]]]),
    }
    renders, alphas, _ = rasterize_reference(*(t.double() for t in tensors.values()), 9, 7, **options)
    return renders[0], alphas[0]


def test_one_gaussian_is_its_closed_form():
    renders, alphas = one_gaussian()
    variance = (10 / 2 * 0.3) ** 2 + 0.3
    y, x = torch.meshgrid(torch.arange(7) - 3.0, torch.arange(9) - 4.0, indexing="ij")
    alpha = 0.6 * torch.exp(-(x * x + y * y).double() / (2 * variance))
    alpha = torch.where(alpha >= 1 / 255, alpha, 0)
    torch.testing.assert_close(alphas[..., 0], alpha)
    torch.testing.assert_close(renders, alpha[..., None] * torch.tensor([0.2, 0.5, 0.9]).double(), rtol=1e-6, atol=1e-8)


def test_antialiasing_keeps_the_blurred_gaussians_mass():
    _, classic = one_gaussian()
    _, antialiased = one_gaussian(rasterize_mode="antialiased")
    sharp = (10 / 2 * 0.3) ** 2
    assert float(antialiased[3, 4] / classic[3, 4]) == pytest.approx(sharp / (sharp + 0.3), rel=1e-6)


def test_expected_depth_of_one_gaussian_is_its_depth():
    renders, alphas = one_gaussian(render_mode="ED")
    seen = alphas[..., 0] > 0
    torch.testing.assert_close(renders[..., 0][seen], torch.full_like(renders[..., 0][seen], 2.0))


def test_the_nearer_gaussian_hides_the_farther_one():
    case = make_case(count=2, cameras=1, channels=3)
    case = replace(
        case,
        means=torch.tensor([[0.0, 0, 3], [0.0, 0, 1]]),
        scales=torch.full((2, 3), 5.0),
        opacities=torch.tensor([1.0, 1.0]),
        colors=torch.tensor([[1.0, 0, 0], [0.0, 1, 0]]),
        viewmats=torch.eye(4)[None],
    )
    renders, _, meta = case.to(torch.float64).render(rasterize_reference)
    middle = renders[0, 16, 24]
    assert middle[1] > 0.998
    assert middle[0] < 0.001
    assert meta.depths.tolist() == [[3.0, 1.0]]


@pytest.mark.parametrize(
    "options",
    [
        {"sh_degree": 2, "render_mode": "RGB+ED", "rasterize_mode": "antialiased"},
        {"sh_degree": 3, "render_mode": "RGB+D"},
        {"channels": 2, "render_mode": "RGB"},
        {"channels": 1, "render_mode": "ED"},
    ],
)
def test_gradients_are_the_numeric_ones(options):
    """Central differences in float64 along random directions, cameras included; opacities stay clear of both ends."""
    case = make_case(count=6, width=7, height=6, cameras=2, scale=0.3, seed=3, **options).to(torch.float64)
    case = replace(case, opacities=0.3 + 0.3 * case.opacities)
    names = [name for name in INPUTS if name != "colors" or "RGB" in case.options["render_mode"]]

    def outputs(*tensors: Tensor) -> tuple[Tensor, Tensor]:
        renders, alphas, _ = replace(case, **dict(zip(names, tensors, strict=True))).render(rasterize_reference)
        return renders, alphas

    leaves = [getattr(case, name).clone().requires_grad_() for name in names]
    assert torch.autograd.gradcheck(outputs, leaves, eps=1e-7, atol=2e-5, rtol=1e-4, fast_mode=True)


def test_gradients_do_not_depend_on_what_is_culled():
    case = make_case(count=60, cameras=1, rasterize_mode="antialiased").to(torch.float64)
    behind = case.means.clone()
    behind[:20] = 50.0
    result = differentiate(
        rasterize_reference, replace(case, means=behind, scales=case.scales * torch.tensor([1, 1, 0.0]))
    )
    assert all(bool(torch.isfinite(gradient).all()) for gradient in result.gradients.values())


def test_where_nothing_is_drawn_gradients_are_zero():
    case = make_case(count=10, cameras=1).to(torch.float64)
    result = differentiate(rasterize_reference, replace(case, means=case.means - torch.tensor([0.0, 0.0, 1e3])))
    assert all(not gradient.any() for gradient in result.gradients.values())


def test_harmonics_and_projection_agree_with_gsplats_torch_code():
    reference = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    case = make_case(count=500, sh_degree=3, cameras=2)
    directions = torch.nn.functional.normalize(case.means, dim=-1)
    expected = reference._spherical_harmonics(3, case.means, case.colors)
    found = (harmonics(3, directions)[..., None] * case.colors).sum(-2)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)
    covariances, _ = reference._quat_scale_to_covar_preci(case.quats, case.scales, True, False)
    radii, means2d, depths, _, _ = reference._fully_fused_projection(
        case.means, covariances, case.viewmats, case.Ks, case.width, case.height
    )
    _, _, meta = case.render(rasterize_reference)
    both = (radii > 0).all(-1) & (meta.radii > 0).all(-1)
    assert int(both.sum()) > 500
    torch.testing.assert_close(meta.means2d[both], means2d[both], rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(meta.depths[both], depths[both])
