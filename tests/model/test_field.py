"""The HexPlane residual: zero where nothing was learned, local in time, and unchanged by a slide."""

import pytest
import torch

from twin_node.model.field import FieldParameters, HexPlane

MS = 1_000_000


def field(columns: int = 4) -> HexPlane:
    made = HexPlane(torch.full((3,), -0.5), torch.full((3,), 0.5), columns, FieldParameters(8, 4, 8), seed=1)
    for i in range(columns):
        made.slide(i * 33 * MS)
    return made


def disturb(made: HexPlane, seed: int = 0) -> None:
    with torch.no_grad():
        made.time += 0.3 * torch.randn(made.time.shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture
def points() -> torch.Tensor:
    return torch.rand(20, 3, generator=torch.Generator().manual_seed(2)) - 0.5


def test_neutral_time_planes_give_exactly_zero(points: torch.Tensor) -> None:
    made = field()
    residual = made.residual(points, [0, 50 * MS, 10_000 * MS])
    assert residual.offsets.shape == (3, 20, 3)
    assert torch.equal(residual.offsets, torch.zeros(3, 20, 3))
    assert torch.equal(residual.rotations, torch.zeros(3, 20, 3))


def test_gradients_reach_the_time_planes_from_the_neutral_state(points: torch.Tensor) -> None:
    made = field()
    made.residual(points, [33 * MS]).offsets.sum().backward()
    assert made.time.grad is not None
    assert bool((made.time.grad[:, :, 1] != 0).any())
    assert not bool((made.time.grad[:, :, 3] != 0).any())


def test_a_slide_changes_nothing_inside_the_window_that_stays(points: torch.Tensor) -> None:
    made = field()
    disturb(made)
    stamps = [33 * MS, 50 * MS, 99 * MS]
    before = made.residual(points, stamps)
    made.slide(132 * MS)
    after = made.residual(points, stamps)
    torch.testing.assert_close(after.offsets, before.offsets, rtol=0, atol=0)
    newest = made.residual(points, [132 * MS])
    torch.testing.assert_close(newest.offsets[0], before.offsets[2], rtol=0, atol=0)
    assert made.stamps == [33 * MS, 66 * MS, 99 * MS, 132 * MS]


def test_time_is_linear_in_the_planes_and_clamped_at_the_ends(points: torch.Tensor) -> None:
    made = field()
    disturb(made)
    ends = made.residual(points, [-5, 0, 99 * MS, 500 * MS]).offsets
    torch.testing.assert_close(ends[0], ends[1], rtol=0, atol=0)
    torch.testing.assert_close(ends[2], ends[3], rtol=0, atol=0)
    between = made._column(int(49.5 * MS))
    torch.testing.assert_close(between, 0.5 * (made._column(33 * MS) + made._column(66 * MS)))


def test_it_learns_a_bend_that_is_there_at_one_time_only(points: torch.Tensor) -> None:
    made = field()
    target = torch.stack([torch.zeros(20), torch.zeros(20), 0.1 * points[:, 0].abs()], -1)
    optimiser = torch.optim.Adam(made.parameters(), lr=0.03)
    for _ in range(150):
        optimiser.zero_grad()
        seen = made.residual(points, [0, 99 * MS]).offsets
        loss = (seen[0] ** 2).mean() + ((seen[1] - target) ** 2).mean() + 1e-6 * made.regularity()
        loss.backward()
        optimiser.step()
    seen = made.residual(points, [0, 99 * MS]).offsets.detach()
    assert float((seen[1] - target).norm(dim=-1).max()) < 0.01
    assert float(seen[0].norm(dim=-1).max()) < 0.005


def test_wrong_sizes_and_stamps_are_refused() -> None:
    with pytest.raises(ValueError, match="lower < upper"):
        HexPlane(torch.zeros(3), torch.zeros(3), 4)
    made = field()
    with pytest.raises(ValueError, match="after"):
        made.slide(99 * MS)
