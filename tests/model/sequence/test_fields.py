"""Fields over a sequence: identity at the start, right gradients, plain references."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from sequence_scenes import SMALL

from twin_node.model import ModelError
from twin_node.model.sequence import Box, SequenceField, SequenceHashMlp, SequenceHexPlane
from twin_node.model.sequence.field import moved_quats
from twin_node.model.sequence.hash_mlp import PRIMES, HashGrid
from twin_node.model.sequence.hex_plane import Planes

BOX = Box(torch.tensor([-1.0, -2.0, 0.0]), torch.tensor([1.0, 2.0, 1.0]))
FIELDS: list[Callable[[int], SequenceField]] = [
    lambda steps: SequenceHexPlane(BOX, steps, SMALL.hexplane, seed=3),
    lambda steps: SequenceHashMlp(BOX, steps, SMALL.hash, seed=3),
]


def points(count: int, seed: int = 0) -> torch.Tensor:
    share = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))
    return BOX.lower + share * (BOX.upper - BOX.lower)


@pytest.mark.parametrize("metres", [1e7, float("nan")])
def test_a_box_without_sides_is_refused(metres: float) -> None:
    """Far points lie at one place in float32; what is looked up at 0 / 0 is read from anywhere."""
    far = torch.full((3,), metres)
    with pytest.raises(ModelError, match=r"^box: expected sides above 0 in float32, found \["):
        Box(far, far + 0.3)


@pytest.mark.parametrize("make", FIELDS)
@pytest.mark.parametrize("steps", [1, 2, 7])
def test_nothing_moves_before_training(make: Callable[[int], SequenceField], steps: int) -> None:
    motion = make(steps).motion(points(5), torch.tensor([-1.0, 0.3, 1.0]))
    assert motion.offsets.shape == (3, 5, 3)
    assert not motion.offsets.any() and not motion.growths.any()
    quats = torch.nn.functional.normalize(torch.rand(5, 4), dim=-1)
    torch.testing.assert_close(moved_quats(quats, motion.turns), quats.expand(3, -1, -1))


@pytest.mark.parametrize("make", FIELDS)
def test_every_learned_number_is_counted_and_in_one_group(make: Callable[[int], SequenceField]) -> None:
    field = make(6)
    grouped = [*field.grids(), *field.decoder()]
    assert {id(p) for p in grouped} == {id(p) for p in field.parameters()} and len(grouped) == len(
        list(field.parameters())
    )
    assert field.parameters_count == sum(p.numel() for p in grouped)


@pytest.mark.parametrize("make", FIELDS)
def test_a_field_can_learn_motion_in_time(make: Callable[[int], SequenceField]) -> None:
    field, at, times = make(8), points(40), torch.linspace(-1, 1, 8)
    target = 0.3 * torch.stack([times, times**2, torch.zeros(8)], 1)[:, None].expand(-1, 40, -1)
    groups = [{"params": field.grids(), "lr": 2e-2}, {"params": field.decoder(), "lr": 1e-2}]
    optimizer = torch.optim.Adam(groups)
    losses = []
    for _ in range(150):
        loss = (field.motion(at, times).offsets - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.02 * losses[0]


@pytest.mark.parametrize("make", FIELDS)
def test_regularity_is_zero_without_motion_and_draws_what_it_is_told(make: Callable[[int], SequenceField]) -> None:
    field = make(7)

    def regularity(seed: int) -> float:
        return float(field.regularity(torch.Generator().manual_seed(seed)).detach())

    still = regularity(1)
    with torch.no_grad():
        for p in field.parameters():
            p.add_(torch.rand(p.shape, generator=torch.Generator().manual_seed(5)))
    assert regularity(1) > still
    assert regularity(1) == regularity(1)


def test_time_planes_alone_bend_the_motion() -> None:
    field = SequenceHexPlane(BOX, 7, SMALL.hexplane)
    with torch.no_grad():
        for p in field.decoder():
            p.add_(torch.rand(p.shape, generator=torch.Generator().manual_seed(5)))
    offsets = field.motion(points(4), torch.tensor([-1.0, 0.0, 1.0])).offsets
    torch.testing.assert_close(offsets[0], offsets[1])
    torch.testing.assert_close(offsets[0], offsets[2])


@pytest.mark.parametrize("make", FIELDS)
def test_points_and_times_outside_are_clamped(make: Callable[[int], SequenceField]) -> None:
    field = make(5)
    with torch.no_grad():
        for p in field.parameters():
            p.add_(torch.rand(p.shape, generator=torch.Generator().manual_seed(5)))
    edge = torch.stack([BOX.upper, BOX.lower])
    beyond = torch.stack([BOX.upper + 5, BOX.lower - 5])
    for a, b in zip(
        vars(field.motion(edge, torch.tensor([1.0]))).values(),
        vars(field.motion(beyond, torch.tensor([1.0]))).values(),
        strict=True,
    ):
        torch.testing.assert_close(a, b)


@pytest.mark.parametrize("make", [FIELDS[0], FIELDS[1]])
def test_no_steps_are_refused(make: Callable[[int], SequenceField]) -> None:
    with pytest.raises(ValueError, match="one time step"):
        make(0)


@given(seed=st.integers(0, 1000), columns=st.integers(2, 6))
def test_planes_are_bilinear_with_both_ends_inside(seed: int, columns: int) -> None:
    """Against a plain reference: the value at a cell's corner is the plane's own number there."""
    random = torch.Generator().manual_seed(seed)
    planes = Planes(5, columns, 2, (1,), random)
    with torch.no_grad():
        planes.time[0].uniform_(0.5, 1.5, generator=random)
    ijk = torch.randint(5, (3,), generator=random)
    column = int(torch.randint(columns, (1,), generator=random))
    unit = (2 * ijk / 4 - 1)[None].float()
    time = torch.tensor([[2 * column / (columns - 1) - 1]])
    space, line = planes.space[0], planes.time[0]
    i, j, k = (int(index) for index in ijk)
    expected = space[0, :, j, i] * space[1, :, k, i] * space[2, :, k, j]
    expected = expected * line[0, :, column, i] * line[1, :, column, j] * line[2, :, column, k]
    torch.testing.assert_close(planes(unit, time)[0, 0], expected, rtol=1e-4, atol=1e-5)


@given(seed=st.integers(0, 1000), axes=st.integers(2, 4))
def test_the_hash_grid_agrees_with_a_plain_one(seed: int, axes: int) -> None:
    random = torch.Generator().manual_seed(seed)
    resolutions = tuple(tuple(int(c) for c in torch.randint(1, 9, (axes,), generator=random)) for _ in range(2))
    grid = HashGrid(resolutions, 2, 64, random)
    unit = 2 * torch.rand(3, axes, generator=random) - 1
    unit[0] = 1.0
    found = grid(unit)
    for row, place in enumerate(unit.double().numpy()):
        expected = []
        for level, cells in enumerate(resolutions):
            at = (place + 1) / 2 * np.array(cells)
            low = np.minimum(np.floor(at), np.array(cells) - 1).astype(int)
            value = np.zeros(2)
            for corner in product((0, 1), repeat=axes):
                weight, hashed = 1.0, 0
                for axis, up in enumerate(corner):
                    share = at[axis] - low[axis]
                    weight *= share if up else 1 - share
                    hashed ^= int(low[axis] + up) * PRIMES[axis]
                value += weight * grid.table[level, hashed % 64].detach().double().numpy()
            expected.extend(value)
        np.testing.assert_allclose(found[row].detach().numpy(), expected, atol=1e-9)


def test_the_hash_grid_sends_gradients_to_places_and_table() -> None:
    random = torch.Generator().manual_seed(1)
    grid = HashGrid(((3, 4, 5),), 2, 64, random).double()
    with torch.no_grad():
        grid.table.uniform_(-1, 1, generator=random)
    unit = (2 * torch.rand(4, 3, generator=random, dtype=torch.float64) - 1).requires_grad_()
    assert torch.autograd.gradcheck(grid, (unit,))
    grid(unit).sum().backward()
    assert grid.table.grad is not None
    # the weights of a point's corners add up to 1
    torch.testing.assert_close(grid.table.grad.sum(), torch.tensor(8.0, dtype=torch.float64))
