"""Recorded steps on CUDA against compiled ones on the CPU; without a device the same work, unrecorded, of stand-ins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from twin_node.splat import (
    Aims,
    Bystanders,
    Course,
    Decays,
    Descended,
    Learners,
    captured_descent,
    descend,
    has_kernels,
    rasterize,
)
from twin_node.splat.captured_descent import descend_captured

CPU = torch.device("cpu")
TIMES, HEIGHT, WIDTH, CARRIERS = 2, 40, 56, 3
pytestmark = pytest.mark.skipif(not has_kernels(CPU), reason="the compiled library is not at hand")


class StandIn:
    """Takes gsplat's calls, hands on what it is given by way of them, and draws on the CPU."""

    def fully_fused_projection(
        self,
        means: Tensor,
        _: None,
        quats: Tensor,
        scales: Tensor,
        viewmats: Tensor,
        Ks: Tensor,
        width: int,
        height: int,
        **options: Any,
    ) -> tuple[Tensor, ...]:
        self.cameras, self.options = (viewmats, Ks, width, height), options
        shape = (len(means), 1, means.shape[1])
        radii = torch.ones(*shape, 2, dtype=torch.int32)
        return radii, means[:, None], torch.zeros(shape), torch.cat([quats, scales], -1)[:, None], torch.zeros(0)

    def isect_tiles(
        self, means2d: Tensor, radii: Tensor, depths: Tensor, size: int, columns: int, rows: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        assert columns * size >= WIDTH and rows * size >= HEIGHT + size
        return radii, torch.arange(5), torch.arange(5, dtype=torch.int32)

    def isect_offset_encode(self, ids: Tensor, images: int, columns: int, rows: int) -> Tensor:
        return torch.zeros(images, rows, columns, dtype=torch.int32)

    def rasterize_to_pixels(
        self,
        means: Tensor,
        turned: Tensor,
        colors: Tensor,
        opacities: Tensor,
        width: int,
        height: int,
        size: int,
        offsets: Tensor,
        meetings: Tensor,
        masks: Tensor,
    ) -> tuple[Tensor, Tensor]:
        assert offsets.shape == masks.shape and len(meetings) >= 5 and not masks[:, :, -1].any()
        options = {name: value for name, value in self.options.items() if name != "opacities"}
        renders, alphas, _ = rasterize(
            means[:, 0],
            turned[:, 0, :, :4],
            turned[:, 0, :, 4:],
            opacities[:, 0],
            colors[..., :3],
            *self.cameras,
            render_mode="RGB+D",
            **options,
        )
        drawn = masks.repeat_interleave(size, 2).repeat_interleave(size, 3)[:, :, :height, :width]
        return renders, torch.where(
            drawn[..., None], alphas, torch.nan
        )  # gsplat leaves what it does not draw as it was


@pytest.fixture(params=["cpu", "cuda"])
def device(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> torch.device:
    """Where recorded steps are tried."""
    captured_descent._RECORDINGS.clear()
    if request.param == "cuda":
        if not torch.cuda.is_available():
            pytest.skip("no CUDA device here: no graph is recorded")
    else:
        monkeypatch.setattr(captured_descent, "Captured", captured_descent.Unrecorded)
        stand_in = StandIn()
        monkeypatch.setattr(captured_descent, "gsplat_module", lambda: stand_in)
    return torch.device(request.param)


def scene(
    count: int, standing: int, *, masked: bool = True, with_depth: bool = True, seed: int = 0
) -> tuple[Learners, Bystanders, Aims]:
    """Gaussians before two cameras, every third of which does not learn, and images of something else."""
    random = torch.Generator().manual_seed(seed)

    def drawn(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=random)

    means = drawn(count, 3) * torch.tensor([1.6, 1.2, 1.0]) - torch.tensor([0.8, 0.6, -2.0])
    values = torch.cat([means, drawn(count, 4) - 0.5, drawn(count, 3) - 3.5, drawn(count, 1), drawn(count, 3)], 1)
    rows = torch.arange(count)[torch.arange(count) % 3 > 0]
    angles = 0.02 * drawn(TIMES, CARRIERS)
    turns = torch.eye(3).repeat(TIMES, CARRIERS, 1, 1)
    turns[..., 0, 0] = turns[..., 1, 1] = angles.cos()
    turns[..., 0, 1], turns[..., 1, 0] = -angles.sin(), angles.sin()
    products = torch.eye(4).repeat(TIMES, CARRIERS, 1, 1)
    learners = Learners(
        rows,
        values,
        torch.zeros_like(values),
        torch.zeros_like(values),
        torch.zeros(count, dtype=torch.int64),
        torch.full((count,), -2.0),
        torch.full((len(rows), 14), 2e-3),
        turns,
        0.02 * drawn(TIMES, CARRIERS, 3),
        products,
        torch.arange(len(rows)) % CARRIERS,
    )
    place = drawn(TIMES, standing, 3) + torch.tensor([-0.5, -0.5, 1.5])
    bystanders = Bystanders(
        place, drawn(TIMES, standing, 4), 0.04 * drawn(standing, 3) + 0.01, drawn(standing), drawn(standing, 3)
    )
    viewmats = torch.eye(4).repeat(TIMES, 1, 1)
    viewmats[1, 0, 3] = 0.1
    K = torch.tensor([[60.0, 0, WIDTH / 2], [0, 60.0, HEIGHT / 2], [0, 0, 1]])
    mask = torch.zeros(TIMES, HEIGHT, WIDTH, dtype=torch.bool)
    mask[0, 3:30, 5:40], mask[1, 20:, 30:] = True, True
    aims = Aims(
        viewmats,
        K.repeat(TIMES, 1, 1),
        drawn(TIMES, HEIGHT, WIDTH, 4) + torch.tensor([0.0, 0, 0, 3]),
        mask if masked else None,
        drawn(TIMES, HEIGHT, WIDTH, 3),
        2.0 * mask if masked else None,
        3 * drawn(TIMES, HEIGHT, WIDTH) * (drawn(TIMES, HEIGHT, WIDTH) > 0.3) if with_depth else None,
        0.05 if with_depth else 0.0,
    )
    return learners, bystanders, aims


def taken(
    given: tuple[Learners, Bystanders, Aims], course: Course, by: Callable[..., Descended], device: torch.device
) -> tuple[Learners, Descended]:
    """Copies of the learners after steps by `by` there, and what was found."""
    learners, bystanders, aims = (
        replace(
            one, **{name: of.detach().to(device, copy=True) for name, of in vars(one).items() if torch.is_tensor(of)}
        )
        for one in given
    )
    found = by(learners, bystanders, aims, course)
    return learners, found


def assert_alike(given: tuple[Learners, Bystanders, Aims], course: Course, device: torch.device) -> None:
    """What steps lead to there is what the compiled ones do."""
    ours, found = taken(given, course, descend_captured, device)
    theirs, expected = taken(given, course, descend, CPU)
    alike = 1.0 if course.steps == 1 else 0.98  # the order in depth is that of the first step, which a few leave
    for name in ("seen", "alphas", "v_means", "v_quats"):
        here, there = getattr(found, name).cpu(), getattr(expected, name)
        assert float(torch.isclose(here, there, atol=2e-4, rtol=2e-3).float().mean()) >= alike, name
    torch.testing.assert_close(found.losses, expected.losses, atol=1e-5, rtol=2e-3)
    assert found.refused == expected.refused
    moved = (theirs.moment1.abs() > 1e-6) & (ours.moment1.cpu().abs() > 1e-6)
    assert moved.any()
    assert float((ours.steps.cpu() == theirs.steps).float().mean()) >= alike
    close = torch.isclose(ours.values.cpu()[moved], theirs.values[moved], atol=2e-4, rtol=0.0)
    assert float(close.float().mean()) >= alike
    held = torch.ones(len(ours.values), dtype=torch.bool)
    held[given[0].rows] = False
    assert torch.equal(ours.values.cpu()[held], given[0].values[held])


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize(("masked", "with_depth"), [(True, True), (False, False)])
def test_steps_are_those_of_the_compiled_library(
    steps: int, masked: bool, with_depth: bool, device: torch.device
) -> None:
    given = scene(90, 20, masked=masked, with_depth=with_depth)
    assert_alike(given, Course(steps, -7.6, Decays(0.65, 0.95)), device)


def test_what_an_earlier_larger_set_left_does_not_show(device: torch.device) -> None:
    course = Course(2, -7.6)
    taken(scene(200, 80, seed=1), course, descend_captured, device)
    assert_alike(scene(30, 4), course, device)
    assert len(captured_descent._RECORDINGS) == 1


def test_more_than_there_is_room_for_is_recorded_anew(device: torch.device) -> None:
    course = Course(1, -7.6)
    for count in (90, 600, 90):
        assert_alike(scene(count, 20, seed=count), course, device)
    assert len(captured_descent._RECORDINGS) == 2


def test_a_target_that_is_not_finite_is_named_and_nothing_changes(device: torch.device) -> None:
    learners, bystanders, aims = scene(90, 20)
    aims.rgb[1, 25, 35, 2] = torch.nan
    given = Learners(*(of.to(device, copy=True) for of in vars(learners).values()))
    others = Bystanders(*(of.to(device) for of in vars(bystanders).values()))
    there = replace(aims, **{name: of.to(device) for name, of in vars(aims).items() if torch.is_tensor(of)})
    with pytest.raises(ValueError, match=r"rgb: expected finite values, found nan at \[1, 25, 35, 2\]"):
        descend_captured(given, others, there, Course(2, -7.6))
    assert torch.equal(given.values.cpu(), learners.values) and not given.moment2.any() and not given.steps.any()


def test_a_gaussian_that_would_not_stay_finite_is_refused_alone(device: torch.device) -> None:
    given = scene(90, 20)
    given[0].moment2[4] = torch.nan
    ours, found = taken(given, Course(1, -7.6), descend_captured, device)
    assert found.refused == 1
    assert torch.equal(ours.values[4].cpu(), given[0].values[4]) and not ours.moment2[4].any()
    assert torch.isfinite(ours.values).all()
