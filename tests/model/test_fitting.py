"""Gradients that are carried back by hand, held to what autograd finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import block, frames, joined, rig, sliding, table

from twin_node import splat
from twin_node.model import ModelParameters, SeedParameters, WindowModel, fitting
from twin_node.model.carriage import carry
from twin_node.model.descending import Descended, Path, descend_fused, descend_reference
from twin_node.model.fitting import FULL_SHARE, affordable_steps, fit_all
from twin_node.model.gaussians import LOG_SCALE, QUICK, RGB, WIDTH, Gaussians, Newborns
from twin_node.model.nodes import Poses
from twin_node.model.photometric import differentiate, goal_of, photometric
from twin_node.model.rendering import Splats, render, shoot
from twin_node.model.rotations import quat_product, rotate
from twin_node.scene import Tier, View

CAMERAS = rig(64, 48)
CPU = torch.device("cpu")


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
    store = Gaussians(count, CPU)
    nobody = torch.full((count,), -1, dtype=torch.int64)
    store.spawn(
        Newborns(splats.means[0], splats.quats[0], splats.scales, splats.opacities, splats.rgb, Tier.STATIC, nobody), 0
    )
    return store


def test_the_first_step_goes_down_the_gradient_that_autograd_finds() -> None:
    store = stored(block(0.1))
    views = frames(0, None, CAMERAS).views
    values = store.values.clone().requires_grad_()
    goal = goal_of(views, [None] * len(views), None, CPU)
    torch.autograd.backward(photometric(shoot(store.standing(values), goal.shots), goal.targets))
    assert values.grad is not None
    fit_all(store, views, 1)
    expected = (1 - QUICK.first) * values.grad  # Adam's first moment after one step
    assert torch.allclose(store.moment1, expected, rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize("depth", [True, False])
def test_what_hardly_shows_keeps_the_colour_of_its_seed_where_depth_tells_its_place(depth: bool) -> None:
    """Under a table whose every pixel pulls towards white, it shows through by less than a tenth of a pixel."""
    under = block(0.0)
    under = replace(under, means=under.means - torch.tensor([0, 0, 0.3]), rgb=torch.full_like(under.rgb, 0.3))
    store, seeds = stored(joined(table(), under)), slice(len(table().rgb), None)
    views = [replace(view, rgb=np.full_like(view.rgb, 255)) for view in frames(0, None, CAMERAS, depth).views]
    before = render(store.standing(store.values), CAMERAS)[0].rgb.mean()
    fit_all(store, views, 20)
    assert render(store.standing(store.values), CAMERAS)[0].rgb.mean() > before + 0.3, "what shows learns"
    strayed = (store.values[seeds, RGB] - 0.3).abs().amax(1)
    assert (strayed.median() < 0.05) == depth


@pytest.mark.parametrize("compiled", [True, False])
def test_a_model_without_room_for_any_gaussian_follows_all_the_same(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without compiled kernels the first fit ended in a traceback of torch's, for nothing had a gradient."""
    if not compiled:
        monkeypatch.setattr(splat, "can_descend", lambda _: False)
    model = WindowModel(ModelParameters(most_gaussians=1, seed=SeedParameters(steps=2)))
    for one in sliding(3, CAMERAS):
        assert len(model.update(one).gaussians.means) <= 1


def test_wide_images_are_fitted_in_larger_pixels_first(monkeypatch: pytest.MonkeyPatch) -> None:
    wide, widths = rig(640, 480), list[int]()

    def watched(gaussians: Gaussians, path: Path, steps: int) -> Descended:
        widths.extend([path.goal.shots.width] * steps)
        return descend_fused(gaussians, path, steps)

    monkeypatch.setattr(fitting, "descend", watched)
    for cameras, expected in ((wide, [320] * 8 + [640] * 4), (rig(639, 480), [639] * 12)):
        store, views = stored(table()), frames(0, None, cameras).views
        store.values[:, RGB] = 0.5
        goal = goal_of(views, [None] * len(views), None, CPU)
        missed = float(photometric(shoot(store.standing(store.values), goal.shots), goal.targets))
        del widths[:]
        fit_all(store, views, 12)
        assert widths == expected
        assert float(photometric(shoot(store.standing(store.values), goal.shots), goal.targets)) < 0.5 * missed


@pytest.mark.parametrize("rows", [48, 37])
def test_each_view_weighs_the_same_however_few_of_its_pixels_there_are_and_count(rows: int) -> None:
    first, *others = frames(0, None, CAMERAS).views
    views = [shortened(first, rows), *others]
    mask = np.zeros((rows, 64), bool)
    mask[20:30, 20:40] = True
    masks = [mask, *([None] * len(others))]
    alone = [differentiate(table(), goal_of([view], [own], None, CPU)) for view, own in zip(views, masks, strict=True)]
    together = differentiate(table(), goal_of(views, masks, None, CPU))
    assert float(together.loss) == pytest.approx(float(sum(one.loss for one in alone)), rel=1e-3)
    of_means = torch.stack([one.gradient.means for one in alone]).sum(0)
    assert share_close(together.gradient.means, of_means, 1e-3, 1e-7) > 0.99


def shortened(view: View, rows: int) -> View:
    """The view's first rows."""
    depth = None if view.depth is None else view.depth[:rows]
    return replace(view, camera=replace(view.camera, height=rows), rgb=view.rgb[:rows], depth=depth)


@pytest.mark.parametrize(("share", "steps"), [(0.0, 3), (FULL_SHARE, 3), (0.75, 2), (1.0, 1)])
def test_more_pixels_take_fewer_steps(share: float, steps: int) -> None:
    masks = [np.zeros((40, 50), bool), np.zeros((20, 30), bool)]
    for mask in masks:
        mask.ravel()[: round(share * mask.size)] = True
    assert affordable_steps(3, masks) == steps
    assert affordable_steps(1, masks) == 1


@pytest.mark.parametrize(
    ("steps", "decays"),
    [(1, QUICK), (2, QUICK), (3, splat.Decays(0.8, 0.95)), (3, splat.Decays())],  # moments that remember, as steps part
)
@pytest.mark.parametrize("rows_of_first", [48, 41])
def test_fused_steps_are_those_of_torch(steps: int, decays: splat.Decays, rows_of_first: int) -> None:
    if not splat.has_kernels(CPU):
        pytest.skip("the compiled library is not at hand")
    views = frames(0, -0.1, CAMERAS, depth=True).views
    generator = torch.Generator().manual_seed(2)
    backdrops = [torch.rand(48, 64, 4, generator=generator) for _ in views]
    for backdrop, view in zip(backdrops, views, strict=True):
        assert view.depth is not None
        backdrop[:, :32] = torch.from_numpy(np.dstack([view.rgb / 255, view.depth])[:, :32])
    views = (shortened(views[0], rows_of_first), *views[1:])
    backdrops[0] = backdrops[0][:rows_of_first]
    masks = [np.zeros(view.rgb.shape[:2], bool) for view in views]
    for mask in masks:
        mask[8:40, 10:60] = True
    outcomes = []
    for descend in (descend_reference, descend_fused):
        store = stored(block(0.1))
        store.values[:, LOG_SCALE] += 0.2 * torch.randn(len(store), 3, generator=torch.Generator().manual_seed(3))
        rows = torch.arange(0, len(store), 2)
        still = store.standing(store.values[1::2])
        goal = goal_of(views, masks, backdrops, CPU)
        carriage = carry(poses(3, 1), torch.full((len(rows),), -1))
        rates = torch.full((len(rows), WIDTH), 1e-3)
        last = descend(store, Path(rows, carriage, rates, still, goal, decays), steps)
        outcomes.append((store, last))
    (plain, of_plain), (fused, of_fused) = outcomes
    alike = 1.0 if steps == 1 else 0.98  # the order in depth is that of the first step, which a few Gaussians leave
    for view, seen, seen_fused in zip(views, of_plain.seen, of_fused.seen, strict=True):
        assert seen.rgb.shape == seen_fused.rgb.shape == view.rgb.shape
        assert share_close(seen.rgbd, seen_fused.rgbd, 0.0, 1e-3) >= alike
    assert share_close(plain.moment1[rows], fused.moment1[rows], 2e-2, 1e-6) >= alike - 0.1 * (steps > 1)
    assert share_close(plain.steps.float(), fused.steps.float(), 0.0, 0.0) >= alike
    assert fused.steps[rows].max() == steps
    moved = plain.moment1.abs() > 1e-5
    assert moved[rows].any() and share_close(plain.values[moved], fused.values[moved], 0.0, 2e-4) >= alike - 0.02
    assert torch.equal(plain.values[1::2], fused.values[1::2])
    assert of_plain.losses == pytest.approx(of_fused.losses, rel=1e-3)


def share_close(a: torch.Tensor, b: torch.Tensor, rtol: float, atol: float) -> float:
    """Share of the elements that are the same but for the tolerances."""
    return float(torch.isclose(a, b, rtol=rtol, atol=atol).float().mean())


def test_fused_steps_that_are_not_finite_are_refused_alone() -> None:
    if not splat.has_kernels(CPU):
        pytest.skip("the compiled library is not at hand")
    store, views = stored(block(0.1)), frames(0, -0.1, CAMERAS).views
    store.moment2[3] = torch.nan
    before = store.values.clone()
    goal = goal_of(views, [None] * len(views), [torch.rand(48, 64, 4) for _ in views], CPU)
    rows = torch.arange(len(store))
    carriage = carry(poses(3, 1), torch.full((len(rows),), -1))
    nobody = store.standing(store.values[:0])
    descend_fused(store, Path(rows, carriage, torch.full((len(rows), WIDTH), 1e-3), nobody, goal), 1)
    assert store.refused == 1 and torch.equal(store.values[3], before[3]) and not store.moment2[3].any()
    assert torch.isfinite(store.values).all() and not torch.equal(store.values[4], before[4])
