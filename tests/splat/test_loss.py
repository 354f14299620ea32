"""The fused image loss against the plain one in float64, and the plain one against what it stands for."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from twin_node.splat import image_loss, image_loss_reference
from twin_node.splat.library import SplatLibrary


def images(count: int, height: int, width: int, channels: int = 3) -> tuple[Tensor, Tensor]:
    random = torch.Generator().manual_seed(height)
    target = torch.nn.functional.avg_pool2d(torch.rand(count, 3, height, width, generator=random), 3, 1, 1)
    target = target.permute(0, 2, 3, 1).contiguous()
    render = torch.cat([target, torch.rand(count, height, width, 1, generator=random)], dim=-1)[..., :channels]
    return render + 0.1 * torch.randn(render.shape, generator=random), target


def gradient_of(loss: Any, render: Tensor, target: Tensor, **options: Any) -> tuple[Tensor, Tensor]:
    leaf = render.clone().requires_grad_()
    value = loss(leaf, target, **options)
    (3 * value).backward()
    return value.detach(), leaf.grad


def patches(height: int, width: int) -> Tensor:
    """Weights of two images: two patches, one of them in a corner, and a single pixel."""
    weights = torch.zeros(2, height, width)
    weights[0, 4:14, 9:29] = 1.0
    weights[0, height - 6 :, width - 5 :] = 0.3
    weights[1, 2, 3] = 2.0
    return weights


@pytest.mark.parametrize("size", [(40, 64), (33, 47), (5, 3), (1, 1), (12, 200)])
@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("weighted", [False, True])
def test_agrees_with_the_plain_loss(size: tuple[int, int], channels: int, weighted: bool, library: SplatLibrary):
    height, width = size
    render, target = images(2, height, width, channels)
    options: dict[str, Any] = {}
    if weighted:
        options["weights"] = patches(40, 64)[:, :height, :width] + (0.1 if height < 40 else 0.0)
        options["weights"] = torch.nn.functional.pad(options["weights"], (0, width - options["weights"].shape[2]))
    if channels == 4:
        options |= {"target_depth": torch.rand(2, height, width), "depth_weight": 0.3}
        options["target_depth"][:, ::3] = 0.0
    doubles = {k: v.double() if isinstance(v, Tensor) else v for k, v in options.items()}
    value, gradient = gradient_of(image_loss, render, target, **options)
    expected, expected_gradient = gradient_of(image_loss_reference, render.double(), target.double(), **doubles)
    assert float(value) == pytest.approx(float(expected), rel=1e-5)
    error = (gradient - expected_gradient).norm() / expected_gradient.norm()
    assert float(error) < 1e-5


def test_numeric_gradient():
    render, target = images(2, 5, 6, 4)
    depth = torch.rand(2, 5, 6).double()
    weights = patches(40, 64)[:, :5, :6].double() + 0.2

    def loss(x: Tensor) -> Tensor:
        return image_loss_reference(x, target.double(), weights=weights, target_depth=depth, depth_weight=0.5)

    assert torch.autograd.gradcheck(loss, render.double().requires_grad_())


def test_the_terms_are_what_they_are_called(library: SplatLibrary):
    render, target = images(1, 30, 40)
    same = image_loss(target, target)
    assert float(same) == pytest.approx(0.0, abs=1e-6)
    only_l1 = image_loss(render, target, l1=1.0, ssim=0.0)
    assert float(only_l1) == pytest.approx(float((render - target).abs().mean()), rel=1e-6)
    flat = torch.full_like(target, 0.25)
    inside = torch.full((1, 30, 40), 1e-9)
    inside[:, 5:-5, 5:-5] = 1.0  # where the window does not leave the image
    unlike = image_loss(flat, 2 * flat, weights=inside, l1=0.0, ssim=1.0)
    c1 = 0.01**2
    assert float(unlike) == pytest.approx(1 - (2 * 0.25 * 0.5 + c1) / (0.25**2 + 0.5**2 + c1), rel=1e-3)


def test_pixels_outside_the_mask_do_not_matter(library: SplatLibrary):
    render, target = images(2, 40, 64)
    mask = patches(40, 64) > 0
    value, gradient = gradient_of(image_loss, render, target, weights=mask)
    spoilt = torch.where(mask[..., None], render, 0.77)
    spoilt_value, spoilt_gradient = gradient_of(image_loss, spoilt, target, weights=mask)
    assert torch.equal(value, spoilt_value)
    assert torch.equal(gradient, spoilt_gradient)
    assert not bool(gradient[~mask].any())


@pytest.mark.parametrize("loss", [image_loss, image_loss_reference])
def test_no_pixel_counts(loss: Any):
    render, target = images(2, 12, 12)
    value, gradient = gradient_of(loss, render, target, weights=torch.zeros(2, 12, 12))
    assert float(value) == 0.0
    assert not bool(gradient.any())


def test_depth_may_be_a_map_or_an_image_of_one_channel(library: SplatLibrary):
    render, target = images(2, 20, 24, 4)
    depth = torch.rand(2, 20, 24)
    value, gradient = gradient_of(image_loss, render, target, target_depth=depth, depth_weight=0.2)
    same, same_gradient = gradient_of(image_loss, render, target, target_depth=depth[..., None], depth_weight=0.2)
    assert torch.equal(value, same)
    assert torch.equal(gradient, same_gradient)


def test_same_bits_for_any_number_of_threads(library: SplatLibrary):
    render, target = images(3, 45, 70)
    before = torch.get_num_threads()
    try:
        results = []
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            results.append(gradient_of(image_loss, render, target))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for other in results[1:] for a, b in zip(other, results[0], strict=True))


def test_leading_dimensions_do_not_matter(library: SplatLibrary):
    render, target = images(4, 16, 18)
    value = image_loss(render, target)
    grouped = image_loss(render.view(2, 2, 16, 18, 3), target.view(2, 2, 16, 18, 3))
    assert torch.equal(value, grouped)


@pytest.mark.parametrize("loss", [image_loss, image_loss_reference])
@pytest.mark.parametrize("name", ["render", "target", "weights", "target_depth"])
def test_values_that_are_not_finite(loss: Any, name: str):
    render, target = images(1, 12, 13, 4)
    tensors = {
        "render": render,
        "target": target,
        "weights": torch.ones(1, 12, 13),
        "target_depth": torch.ones(1, 12, 13),
    }
    tensors[name][0, 11, 12] = float("nan")
    with pytest.raises(ValueError, match=rf"^{name}: expected finite"):
        loss(**tensors, depth_weight=0.1)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"render": torch.zeros(1, 8, 9, 2)}, "render"),
        ({"render": torch.zeros(8, 3)}, "render"),
        ({"render": torch.zeros(1, 0, 9, 3)}, "render"),
        ({"render": torch.zeros(1, 8, 9, 3, dtype=torch.int32)}, "render"),
        ({"target": torch.zeros(1, 8, 8, 3)}, "target"),
        ({"target": torch.zeros(1, 8, 9, 3, dtype=torch.float64)}, "target"),
        ({"weights": torch.zeros(1, 8, 9, 1)}, "weights"),
        ({"target_depth": torch.zeros(8, 9)}, "target_depth"),
        ({"depth_weight": 0.5}, "depth_weight"),
        ({"l1": -1.0}, "l1"),
        ({"ssim": float("nan")}, "ssim"),
    ],
)
def test_wrong_arguments(change: dict[str, Any], name: str):
    arguments = {"render": torch.zeros(1, 8, 9, 3), "target": torch.zeros(1, 8, 9, 3), **change}
    with pytest.raises(ValueError, match=rf"^{name}: expected"):
        image_loss(**arguments)
