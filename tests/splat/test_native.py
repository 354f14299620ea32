"""The compiled rasteriser against the plain one in float64, over a grid of options, and what only it promises."""

from __future__ import annotations

import ctypes
import shutil
import threading
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from splat_scenes import INPUTS, Case, assert_close, differentiate, make_case

from twin_node import native_build
from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat import rasterize, rasterize_reference
from twin_node.splat.library import SplatLibrary, torch_alone


def parity_cases() -> dict[str, Case]:
    random = torch.Generator().manual_seed(5)
    mask = torch.rand(2, 37, 50, generator=random) > 0.7
    mask[0, :20] = False
    return {
        "degree 0": make_case(sh_degree=0, render_mode="RGB+D", backgrounds=torch.rand(2, 3, generator=random)),
        "degree 1, odd size": make_case(width=37, height=29, sh_degree=1),
        "degree 2, antialiased": make_case(sh_degree=2, rasterize_mode="antialiased", seed=1),
        "degree 3, expected depth": make_case(sh_degree=3, render_mode="RGB+ED", seed=2),
        "depth alone": make_case(sh_degree=1, render_mode="D"),
        "expected depth alone": make_case(channels=3, render_mode="ED", backgrounds=torch.rand(2, 3, generator=random)),
        "one channel": make_case(channels=1),
        "two channels": make_case(channels=2, backgrounds=torch.rand(2, 2, generator=random)),
        "eight channels and depth": make_case(channels=8, render_mode="RGB+D"),
        "nineteen channels": make_case(channels=19, render_mode="RGB+ED",
                                       backgrounds=torch.rand(2, 19, generator=random)),
        "nearly opaque": replace(make_case(channels=3), opacities=torch.full((300,), 0.999)),
        "nearly clear": replace(make_case(channels=3), opacities=torch.full((300,), 0.006)),
        "huge": make_case(count=80, channels=3, scale=2.0),
        "tiny": make_case(count=1500, channels=3, scale=0.004),
        "tiny, antialiased": make_case(count=1500, channels=3, scale=0.01, rasterize_mode="antialiased"),
        "flat and long": replace(make_case(channels=3), scales=torch.tensor([[0.6, 0.03, 0.001]]).expand(300, 3)),
        "clipped by radius": make_case(count=800, channels=3, scale=0.03, radius_clip=3.0),
        "near and far planes": make_case(channels=3, near_plane=2.0, far_plane=3.0),
        "mask": make_case(width=50, height=37, sh_degree=2, render_mode="RGB+ED", pixel_mask=mask,
                          backgrounds=torch.rand(2, 3, generator=random)),
        "many": make_case(count=6000, width=100, height=70, cameras=3, sh_degree=0, scale=0.05),
    }  # fmt: skip


CASES = parity_cases()


@pytest.mark.parametrize("name", CASES)
def test_agrees_with_the_plain_version(name: str, library: SplatLibrary):
    expected = differentiate(rasterize_reference, CASES[name].to(torch.float64))
    found = differentiate(rasterize, CASES[name])
    assert float(expected.alphas.max()) > 0.005
    assert_close(found, expected)
    sought = (found.meta.radii > 0) if "pixel_mask" in CASES[name].options else torch.tensor(True)
    assert float(((found.meta.radii != expected.meta.radii) & sought).float().mean()) < 2e-3
    drawn = (found.meta.radii > 0).all(-1) & (expected.meta.radii > 0).all(-1)
    near = drawn & (expected.meta.means2d.abs() < 1000).all(-1)
    torch.testing.assert_close(found.meta.means2d[near].double(), expected.meta.means2d[near], rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(found.meta.depths[drawn].double(), expected.meta.depths[drawn], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("variant", native_build.supported_variants()[1:])
def test_every_instruction_set_agrees(variant: str, monkeypatch: pytest.MonkeyPatch):
    other = native.SplatLibrary.of(variant)
    monkeypatch.setattr(native, "kernels", lambda: other)
    for name in ("degree 3, expected depth", "nineteen channels", "flat and long", "mask"):
        assert_close(
            differentiate(rasterize, CASES[name]), differentiate(rasterize_reference, CASES[name].to(torch.float64))
        )


def stack_moments(case: Case, shift: float = 0.05) -> Case:
    """Each camera sees the means at a time of its own."""
    cameras = case.viewmats.shape[0]
    moved = torch.stack([case.means + shift * index for index in range(cameras)])
    return replace(case, means=moved, viewmats=case.viewmats[:, None], Ks=case.Ks[:, None])


def test_means_per_camera_share_the_rest(library: SplatLibrary):
    case = stack_moments(make_case(sh_degree=1, cameras=3))
    found = differentiate(rasterize, case)
    assert found.renders.shape == (3, 1, 32, 48, 3)
    assert found.meta.radii.shape == (3, 1, 300, 2)
    for index in range(3):
        own = replace(case, means=case.means[index], viewmats=case.viewmats[index], Ks=case.Ks[index])
        renders, alphas, _ = own.render(rasterize)
        assert torch.equal(found.renders[index], renders)
        assert torch.equal(found.alphas[index], alphas)
    assert_close(found, differentiate(rasterize_reference, case.to(torch.float64)))
    expanded = replace(
        case,
        quats=case.quats.expand(3, -1, -1),
        scales=case.scales.expand(3, -1, -1),
        opacities=case.opacities.expand(3, -1),
        colors=case.colors.expand(3, -1, -1, -1),
    )
    again = differentiate(rasterize, expanded)
    assert torch.equal(again.renders, found.renders)
    for name in ("quats", "scales", "opacities", "colors"):
        summed = again.gradients[name].sum(0)
        torch.testing.assert_close(summed, found.gradients[name], rtol=1e-4, atol=1e-4 * float(summed.abs().max()))


@pytest.mark.parametrize("channels", [3, None])
def test_colors_per_camera(channels: int | None, library: SplatLibrary):
    case = make_case(channels=channels, sh_degree=1, cameras=2)
    colors = torch.stack([case.colors, 1 - case.colors])
    case = replace(case, colors=colors)
    assert_close(differentiate(rasterize, case), differentiate(rasterize_reference, case.to(torch.float64)))


def test_gradient_of_the_backgrounds(library: SplatLibrary):
    backgrounds = torch.rand(2, 3)
    case = make_case(sh_degree=0, render_mode="RGB+D", pixel_mask=torch.rand(2, 32, 48) > 0.3)
    gradients = []
    for renderer, dtype in ((rasterize, torch.float32), (rasterize_reference, torch.float64)):
        leaf = backgrounds.to(dtype).requires_grad_()
        renders, _, _ = case.to(dtype).with_options(backgrounds=leaf).render(renderer)
        gradients.append(torch.autograd.grad(renders.square().sum(), leaf)[0].double())
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-4, atol=1e-4)


def test_mask_selects_pixels_of_the_whole_image(library: SplatLibrary):
    case = make_case(count=500, width=60, height=45, sh_degree=1, backgrounds=torch.rand(2, 3))
    mask = torch.rand(2, 45, 60, generator=torch.Generator().manual_seed(2)) > 0.9
    mask[1, :, 20:] = False
    whole, alphas, _ = case.render(rasterize)
    part, part_alphas, _ = case.with_options(pixel_mask=mask).render(rasterize)
    assert torch.equal(part[mask], whole[mask])
    assert torch.equal(part_alphas[mask], alphas[mask])
    background = case.options["backgrounds"][:, None, None].expand_as(part)
    assert torch.equal(part[~mask], background[~mask])
    assert not bool(part_alphas[~mask].any())


def test_an_empty_mask_renders_nothing(library: SplatLibrary):
    case = make_case(channels=3, pixel_mask=torch.zeros(2, 32, 48, dtype=torch.bool))
    result = differentiate(rasterize, case)
    assert not bool(result.renders.any())
    assert not any(bool(gradient.any()) for gradient in result.gradients.values())


def test_same_bits_for_any_number_of_threads(library: SplatLibrary):
    case = make_case(count=3000, width=90, height=70, cameras=3, sh_degree=2, render_mode="RGB+ED")
    before = torch.get_num_threads()
    try:
        results = []
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            results.append(differentiate(rasterize, case))
    finally:
        torch.set_num_threads(before)
    for other in results[1:]:
        assert torch.equal(other.renders, results[0].renders)
        for name, gradient in results[0].gradients.items():
            assert torch.equal(other.gradients[name], gradient), name


def test_torch_keeps_to_one_thread_where_it_is_told_to_and_the_library_does_not(library: SplatLibrary):
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        with torch_alone():
            assert (torch.get_num_threads(), thread_count()) == (1, 3)
            with torch_alone():
                assert thread_count() == 3
            assert (torch.get_num_threads(), thread_count()) == (1, 3)
        assert (torch.get_num_threads(), thread_count()) == (3, 3)
    finally:
        torch.set_num_threads(before)


def test_torchs_runtime_is_found_where_it_is_not_shown_to_the_whole_process(library: SplatLibrary, monkeypatch):
    monkeypatch.setattr(native, "_shown", lambda: None)
    monkeypatch.setattr(native, "_runtime", native._runtime.__wrapped__)
    before = torch.get_num_threads()
    try:
        native.limit_torch(before + 2)
        assert torch.get_num_threads() == before + 2
    finally:
        torch.set_num_threads(before)


def test_no_runtime_is_torchs_but_the_one_that_it_heeds(library: SplatLibrary, tmp_path: Path):
    foreign = tmp_path / "libgomp-foreign.so"
    shutil.copy(next(iter(native._loaded()))._name, foreign)
    before = torch.get_num_threads()
    assert not native._is_torchs(ctypes.CDLL(str(foreign)))
    assert torch.get_num_threads() == before


def test_concurrent_calls_do_not_mix(library: SplatLibrary):
    cases = [make_case(count=400 + 50 * seed, sh_degree=1, seed=seed) for seed in range(3)]
    expected = [differentiate(rasterize, case) for case in cases]
    mistakes: list[str] = []

    def work(index: int) -> None:
        for _ in range(10):
            found = differentiate(rasterize, cases[index])
            same = torch.equal(found.renders, expected[index].renders)
            same &= all(torch.equal(found.gradients[k], v) for k, v in expected[index].gradients.items())
            if not same:
                mistakes.append(f"case {index}")

    threads = [threading.Thread(target=work, args=(index,)) for index in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert mistakes == []


def test_several_images_may_wait_for_their_backward_pass(library: SplatLibrary):
    case = make_case(sh_degree=0)
    means = case.means.clone().requires_grad_()
    shifts = (0.0, 0.1, 0.2)
    losses = [replace(case, means=means + shift).render(rasterize)[0].square().sum() for shift in shifts]
    together = torch.autograd.grad(sum(losses), means)[0]
    apart = torch.zeros_like(together)
    for shift in reversed(shifts):
        loss = replace(case, means=means + shift).render(rasterize)[0].square().sum()
        apart += torch.autograd.grad(loss, means)[0]
    torch.testing.assert_close(together, apart)


def test_backward_twice_gives_the_same_gradient(library: SplatLibrary):
    case = make_case(channels=12)
    means = case.means.clone().requires_grad_()
    loss = replace(case, means=means).render(rasterize)[0].square().sum()
    first = torch.autograd.grad(loss, means, retain_graph=True)[0]
    assert torch.equal(torch.autograd.grad(loss, means)[0], first)


def masked_case() -> Case:
    mask = torch.rand(2, 32, 48, generator=torch.Generator().manual_seed(4)) > 0.3
    return make_case(channels=3, pixel_mask=mask, backgrounds=torch.rand(2, 3))


def test_saved_tensors_may_come_back_as_copies(library: SplatLibrary):
    """As those of checkpoints, or kept elsewhere: the backward pass reads what it is given back, no other memory."""
    case = masked_case()
    case = replace(case, **{name: getattr(case, name).requires_grad_() for name in INPUTS})
    leaves = [getattr(case, name) for name in INPUTS]
    renders, alphas, _ = case.render(rasterize)
    pulls = (renders.detach().clone(), alphas.detach().clone())
    expected = torch.autograd.grad((renders, alphas), leaves, pulls)
    saved: list[torch.Tensor] = []

    def pack(tensor: torch.Tensor) -> torch.Tensor:
        saved.append(tensor)
        return tensor.clone()

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda copy: copy):
        renders, alphas, _ = case.render(rasterize)
    for tensor in saved:
        tensor.data.fill_(1 if tensor.dtype == torch.bool else 7)  # as memory that has been freed and taken again
    found = torch.autograd.grad((renders, alphas), leaves, pulls)
    for name, gradient, same in zip(INPUTS, found, expected, strict=True):
        assert torch.equal(gradient, same), name


def test_a_mask_that_was_changed_is_told(library: SplatLibrary):
    case = masked_case()
    means = case.means.clone().requires_grad_()
    renders, _, _ = replace(case, means=means).render(rasterize)
    case.options["pixel_mask"][:, :16] = False
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        renders.sum().backward()


def test_overflowing_projections_are_culled(library: SplatLibrary):
    """Values are finite, what they project to is not."""
    case = make_case(count=40, channels=3)
    means, scales = case.means.clone(), case.scales.clone()
    means[:5] = 3e38
    scales[5:10] = 1e30
    scales[10:15] = 0.0
    result = differentiate(rasterize, replace(case, means=means, scales=scales))
    assert bool(torch.isfinite(result.renders).all())
    assert bool(torch.isfinite(result.gradients["means"][15:]).all())


def test_gaussians_without_a_size_are_drawn_as_the_blur(library: SplatLibrary):
    case = replace(make_case(channels=3), scales=torch.zeros(300, 3))
    assert_close(differentiate(rasterize, case), differentiate(rasterize_reference, case.to(torch.float64)))


@pytest.mark.parametrize("times", [0.2, 3.0])
def test_cameras_in_other_units_see_as_much(times: float, library: SplatLibrary):
    """What reaches into the image from beside it was not drawn by a camera that makes all larger."""
    case = make_case(count=600, channels=3, render_mode="RGB+D")
    viewmats = case.viewmats.clone()
    viewmats[:, :3, :3] *= times
    viewmats[:, :3, 3] *= times
    shear = torch.eye(4)
    shear[0, 1] = 1.5
    wide = replace(case, means=case.means * torch.tensor([2.0, 2.0, 1.0]), viewmats=shear @ viewmats)
    expected = differentiate(rasterize_reference, wide.to(torch.float64))
    found = differentiate(rasterize, wide)
    assert_close(found, expected)
    assert float((found.meta.radii != expected.meta.radii).float().mean()) < 2e-3


def test_equal_depths_keep_the_gaussians_order(library: SplatLibrary):
    case = make_case(count=64, cameras=1, channels=3)
    flat = case.means.clone()
    flat[:, 2] = 1.5
    case = replace(case, means=flat, viewmats=torch.eye(4)[None])
    assert_close(differentiate(rasterize, case), differentiate(rasterize_reference, case.to(torch.float64)))
