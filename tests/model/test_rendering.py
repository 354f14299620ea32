"""Drawn Gaussians before what stands behind them."""

from __future__ import annotations

import torch

from twin_node.model.rendering import put_before, put_before_reference


def test_compiled_images_before_their_backdrops_are_those_in_torch_to_the_bit() -> None:
    generator = torch.Generator().manual_seed(3)
    renders, backdrop = (torch.rand(2, 13, 17, 4, generator=generator) for _ in range(2))
    alphas = torch.rand(2, 13, 17, 1, generator=generator)
    alphas[:, ::3], renders[:, ::3] = 0, 0
    expected = put_before_reference(renders, alphas, backdrop)
    assert torch.equal(put_before(renders.clone(), alphas, backdrop), expected)
    assert torch.equal(expected[:, ::3], backdrop[:, ::3]), "where nothing is drawn the backdrop shows"


def test_what_is_put_before_a_backdrop_has_its_gradient() -> None:
    renders = torch.full((1, 2, 2, 4), 0.5, requires_grad=True)
    alphas = torch.full((1, 2, 2, 1), 0.25, requires_grad=True)
    put_before(renders, alphas, torch.ones(1, 2, 2, 4)).sum().backward()
    assert renders.grad is not None and alphas.grad is not None
    assert renders.grad.tolist() == torch.ones(1, 2, 2, 4).tolist()
    assert alphas.grad.tolist() == torch.full((1, 2, 2, 1), -4.0).tolist()
