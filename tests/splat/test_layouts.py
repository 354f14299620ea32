"""What the compiled library takes by its address is looked at first: of another shape or kind it is named, not read."""

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
    Descended,
    Learners,
    Missed,
    Pull,
    Shot,
    Sight,
    Tolerance,
    descend,
    draw_still,
    has_kernels,
    image_loss,
    place,
    rasterize,
    weigh,
)

pytestmark = pytest.mark.skipif(not has_kernels(torch.device("cpu")), reason="no compiled kernels here")
COUNT, HEIGHT, WIDTH = 6, 9, 12
INTRINSICS = torch.tensor([[12.0, 0, WIDTH / 2], [0, 12, HEIGHT / 2], [0, 0, 1]])
Call = Callable[..., Any]


def drawn() -> dict[str, Tensor]:
    """Gaussians before a camera at the origin."""
    generator = torch.Generator().manual_seed(0)
    return {
        "means": torch.randn(COUNT, 3, generator=generator) + torch.tensor([0, 0, 4.0]),
        "quats": torch.randn(COUNT, 4, generator=generator),
        "scales": torch.full((COUNT, 3), 0.1),
        "opacities": torch.full((COUNT,), 0.5),
    }


SHOT = {**drawn(), "rgb": torch.rand(COUNT, 3), "viewmat": torch.eye(4), "K": INTRINSICS}
GAUSSIANS = {**drawn(), "rgb": torch.rand(COUNT, 3), "learners": torch.ones(COUNT, dtype=torch.bool)}
SIGHT = {
    "viewmat": torch.eye(4),
    "K": INTRINSICS,
    "rgb": torch.rand(HEIGHT, WIDTH, 3),
    "counted": torch.ones(HEIGHT, WIDTH, dtype=torch.bool),
    "depth": torch.ones(HEIGHT, WIDTH),
    "surface": torch.ones(HEIGHT, WIDTH),
}
PLACED = {
    "values": torch.randn(COUNT, 14),
    "carriers": torch.zeros(COUNT, dtype=torch.int64),
    "positions": torch.zeros(1, 2, 3, dtype=torch.float64),
    "quats": torch.ones(1, 2, 4, dtype=torch.float64),
    "rows": torch.arange(3),
}
LEARNERS = {
    "rows": torch.arange(3),
    "values": torch.cat([drawn()["means"], torch.randn(COUNT, 11)], 1),
    "moment1": torch.zeros(COUNT, 14),
    "moment2": torch.zeros(COUNT, 14),
    "steps": torch.zeros(COUNT, dtype=torch.int64),
    "ceilings": torch.zeros(COUNT),
    "rates": torch.full((3, 14), 1e-3),
    "turns": torch.eye(3).expand(1, 2, 3, 3).clone(),
    "shifts": torch.zeros(1, 2, 3),
    "products": torch.eye(4).expand(1, 2, 4, 4).clone(),
    "carriers": torch.zeros(3, dtype=torch.int64),
}
BYSTANDERS = {
    **drawn(),
    "means": drawn()["means"][None],
    "quats": drawn()["quats"][None],
    "colors": torch.rand(COUNT, 3),
}
AIMS = {
    "viewmats": torch.eye(4)[None],
    "Ks": INTRINSICS[None],
    "backdrop": torch.zeros(1, HEIGHT, WIDTH, 4),
    "pixel_mask": torch.ones(1, HEIGHT, WIDTH, dtype=torch.bool),
    "rgb": torch.rand(1, HEIGHT, WIDTH, 3),
    "weights": torch.ones(1, HEIGHT, WIDTH),
    "depth": torch.ones(1, HEIGHT, WIDTH),
}


def add_missed(**given: Tensor) -> Pull:
    sight = Sight(**{name: given.get(f"sight_{name}", of) for name, of in SIGHT.items()})
    missed = Missed(*(given.get(name, of) for name, of in GAUSSIANS.items()))
    missed.add(sight, Tolerance(0.1, 1.0, 0.05))
    return missed.pull


def descended(**given: Tensor) -> Descended:
    bystanders = Bystanders(**{name: given.get(name, of) for name, of in BYSTANDERS.items()})
    learners = Learners(**{name: given.get(name, of.clone()) for name, of in LEARNERS.items()})
    aims = Aims(**{name: given.get(name, of) for name, of in AIMS.items()}, depth_weight=0.1)
    return descend(learners, bystanders, aims, Course(1, -9.0))


CALLS: dict[str, tuple[Call, dict[str, Tensor]]] = {
    "still": (lambda **given: draw_still(Shot(**{**SHOT, **given}, width=WIDTH, height=HEIGHT)), SHOT),
    "weigh": (lambda **given: weigh(Shot(**{**SHOT, **given}, width=WIDTH, height=HEIGHT)), SHOT),
    "place": (lambda **given: place(**{**PLACED, **given}), PLACED),
    "missed": (add_missed, {**GAUSSIANS, **{f"sight_{name}": of for name, of in SIGHT.items()}}),
    "descend": (descended, {**LEARNERS, **BYSTANDERS, **AIMS}),
}
CASES = [(call, name) for call, (_, given) in CALLS.items() for name in given]
CONVERTED = {"still": set(SHOT), "weigh": set(SHOT), "place": {"values", "positions", "quats"}}
"""What each call itself makes the kind of number that it takes."""


def tensors(found: Any) -> list[Tensor]:
    """All that a call gives back."""
    if isinstance(found, Tensor):
        return [found.detach()]
    parts = found if isinstance(found, tuple) else vars(found).values()
    return [tensor for part in parts if not isinstance(part, int) for tensor in tensors(part)]


def seen() -> tuple[Any, ...]:
    """Of the differentiable calls: images, their loss, and its gradient by the means."""
    means = SHOT["means"].clone().requires_grad_()
    others = (SHOT[name] for name in ("quats", "scales", "opacities", "rgb"))
    drawn = rasterize(means, *others, SHOT["viewmat"][None], SHOT["K"][None], WIDTH, HEIGHT)
    loss = image_loss(drawn[0][0], SIGHT["rgb"])
    return *drawn, loss, torch.autograd.grad(loss, means)[0]


@pytest.mark.parametrize("call", [*CALLS, "rasterize"])
@pytest.mark.parametrize("default", [torch.float64, "meta"])
def test_what_torch_makes_by_default_changes_nothing(call: str, default: torch.dtype | str) -> None:
    """Scripts that count in float64, or elsewhere: images were what lay in memory that nobody had written."""
    make = CALLS[call][0] if call in CALLS else seen
    expected = tensors(make())
    before = torch.get_default_dtype()
    try:
        if isinstance(default, torch.dtype):
            torch.set_default_dtype(default)
        else:
            torch.set_default_device(default)
        found = tensors(make())
    finally:
        torch.set_default_dtype(before)
        torch.set_default_device(None)
    assert len(found) == len(expected) > 0
    assert all(torch.equal(a, b) and a.dtype == b.dtype for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("call", CALLS)
def test_what_fits_is_taken(call: str) -> None:
    CALLS[call][0]()


@pytest.mark.parametrize(("call", "name"), CASES)
def test_another_shape_is_named(call: str, name: str) -> None:
    work, given = CALLS[call]
    tensor = given[name]
    for axis in range(tensor.dim()):
        shorter = tensor.narrow(axis, 0, tensor.shape[axis] - 1) if tensor.shape[axis] > 1 else tensor.squeeze(axis)
        if (call, name) == ("place", "rows") and shorter.dim():
            continue  # fewer are wanted
        with pytest.raises(ValueError, match=r"^\w+: expected \[.*\] torch.* on cpu, found \[.*"):
            work(**{name: shorter})


@pytest.mark.parametrize(("call", "name"), [case for case in CASES if case[1] not in CONVERTED.get(case[0], ())])
def test_another_kind_is_named(call: str, name: str) -> None:
    work, given = CALLS[call]
    other = {torch.float32: torch.float64, torch.int64: torch.int32, torch.bool: torch.float32}[given[name].dtype]
    with pytest.raises(ValueError, match=rf"^{name.removeprefix('sight_')}: expected .* found .* {other} on cpu$"):
        work(**{name: given[name].to(other)})


@pytest.mark.parametrize("name", ["values", "moment1", "moment2", "steps"])
def test_what_is_brought_up_to_date_must_lie_in_one_piece(name: str) -> None:
    tensor = LEARNERS[name]
    with pytest.raises(ValueError, match=f"^{name}: expected rows that lie one after the other"):
        descended(**{name: torch.stack([tensor, tensor], -1)[..., 0]})


def test_no_steps_are_refused() -> None:
    aims, bystanders = Aims(**AIMS, depth_weight=0.1), Bystanders(**BYSTANDERS)
    with pytest.raises(ValueError, match=r"^steps: expected 1 or more, found 0$"):
        descend(Learners(**LEARNERS), bystanders, aims, Course(0, -9.0))


def test_depth_needs_what_stands_behind() -> None:
    sight = replace(Sight(**SIGHT), surface=None)
    with pytest.raises(ValueError, match=r"^surface: expected what stands behind"):
        Missed(*GAUSSIANS.values()).add(sight, Tolerance(0.1, 1.0, 0.05))
