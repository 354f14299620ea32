"""Gradients that are carried back by hand, held to what autograd finds."""

from __future__ import annotations

import torch
from model_scenes import block, frames, rig, table

from twin_node.model.carriage import carry
from twin_node.model.fitting import fit_all, photometric, targets_of
from twin_node.model.gaussians import Gaussians, Newborns
from twin_node.model.nodes import Poses
from twin_node.model.rendering import Splats, draw
from twin_node.model.rotations import quat_product, rotate
from twin_node.scene import Tier

CAMERAS = rig(64, 48)


def poses(times: int, count: int) -> Poses:
    """Random node poses."""
    generator = torch.Generator().manual_seed(0)
    quats = torch.randn(times, count, 4, generator=generator, dtype=torch.float64)
    positions = torch.randn(times, count, 3, generator=generator, dtype=torch.float64)
    return Poses(positions, quats / quats.norm(dim=-1, keepdim=True))


def test_a_carriage_turns_and_shifts_as_the_node_does() -> None:
    at, carriers = poses(2, 3), torch.tensor([0, 2, -1, 2])
    means, quats = torch.randn(4, 3), torch.randn(4, 4)
    carriage = carry(at, carriers)
    moved, turned = carriage.means(means), carriage.quats(quats)
    for time in range(2):
        for index, node in enumerate(carriers.tolist()):
            if node < 0:
                assert torch.equal(moved[time, index], means[index])
                assert torch.equal(turned[time, index], quats[index])
                continue
            q, p = at.quats[time, node].float(), at.positions[time, node].float()
            assert torch.allclose(moved[time, index], rotate(q, means[index]) + p, atol=1e-5)
            assert torch.allclose(turned[time, index], quat_product(q, quats[index]), atol=1e-5)


def test_a_carriage_takes_gradients_back_as_autograd_does() -> None:
    carriage = carry(poses(3, 2), torch.tensor([1, 0, -1]))
    means, quats = torch.randn(3, 3).requires_grad_(), torch.randn(3, 4).requires_grad_()
    of_means, of_quats = torch.randn(3, 3, 3), torch.randn(3, 3, 4)
    torch.autograd.backward([carriage.means(means), carriage.quats(quats)], [of_means, of_quats])
    assert means.grad is not None and quats.grad is not None
    assert torch.allclose(carriage.means_gradient(of_means).sum(0), means.grad, atol=1e-5)
    assert torch.allclose(carriage.quats_gradient(of_quats).sum(0), quats.grad, atol=1e-5)


def stored(splats: Splats) -> Gaussians:
    """STATIC Gaussians `splats`."""
    count = splats.means.shape[1]
    store = Gaussians(count, torch.device("cpu"))
    nobody = torch.full((count,), -1, dtype=torch.int64)
    store.spawn(
        Newborns(splats.means[0], splats.quats[0], splats.scales, splats.opacities, splats.rgb, Tier.STATIC, nobody), 0
    )
    return store


def test_the_first_step_goes_down_the_gradient_that_autograd_finds() -> None:
    store = stored(block(0.1))
    views = frames(0, None, CAMERAS).views
    values = store.values.clone().requires_grad_()
    targets = targets_of(views, [None] * len(views), torch.device("cpu"))
    torch.autograd.backward(photometric(draw(store.standing(values), CAMERAS), targets))
    assert values.grad is not None
    fit_all(store, views, 1)
    expected = 0.1 * values.grad  # Adam's first moment after one step
    assert torch.allclose(store.moment1, expected, rtol=1e-3, atol=1e-7)


def test_each_view_weighs_the_same_however_few_of_its_pixels_count() -> None:
    views = frames(0, None, CAMERAS).views
    sheets = draw(table(), CAMERAS)
    mask = torch.zeros(48, 64, dtype=torch.bool)
    mask[20:30, 20:40] = True
    whole = [targets_of([view], [None], torch.device("cpu")) for view in views]
    alone = [photometric(draw(table(), [camera]), own) for camera, own in zip(CAMERAS, whole, strict=True)]
    masks = [mask.numpy(), *([None] * (len(views) - 1))]
    first = photometric(draw(table(), CAMERAS[:1]), targets_of(views[:1], masks[:1], torch.device("cpu")))
    both = photometric(sheets, targets_of(views, masks, torch.device("cpu")))
    assert torch.allclose(both, first + torch.stack(alone[1:]).sum(), rtol=1e-3)
