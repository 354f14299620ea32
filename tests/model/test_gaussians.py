"""Fixed-capacity storage: births, deaths, boarding a node, and steps that stay in bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from twin_node import splat
from twin_node.model.field import HexPlane
from twin_node.model.gaussians import IDS, LARGEST, LOG_SCALE, MEAN, RGB, Gaussians, Newborns
from twin_node.model.motion import Motion
from twin_node.model.nodes import Nodes
from twin_node.model.rotations import quat_from_vector
from twin_node.scene import Tier


def newborns(count: int, tier: Tier = Tier.STATIC) -> Newborns:
    """Gaussians at whole metres along x."""
    means = torch.zeros(count, 3)
    means[:, 0] = torch.arange(count)
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1
    nobody = torch.full((count,), -1, dtype=torch.int64)
    return Newborns(
        means, quats, torch.full((count, 3), 0.01), torch.full((count,), 0.5), torch.full((count, 3), 0.5), tier, nobody
    )


def test_more_births_than_room_fill_the_room_and_no_more() -> None:
    store = Gaussians(5, torch.device("cpu"))
    assert len(store.spawn(newborns(3), 1)) == 3
    assert len(store.spawn(newborns(4), 2)) == 2
    assert len(store) == 5
    store.retire(torch.tensor([1]))
    rows = store.spawn(newborns(2), 3)
    assert rows.tolist() == [1]
    assert sorted(store.ids.tolist()) == [0, 2, 3, 4, 5]


def test_ids_that_have_run_out_are_used_again_by_nobody_while_they_live() -> None:
    """Clouds tell 32 bits of them: a newborn with the id of what stands would take its place for who reads them."""
    store = Gaussians(12, torch.device("cpu"))
    store.spawn(newborns(5), 1)
    store.retire(torch.tensor([0, 1, 3]))
    store._next_id = IDS - 2
    last = store.spawn(newborns(2), 2)
    assert store.ids[last].tolist() == [IDS - 2, IDS - 1]
    assert store.ids[store.spawn(newborns(1), 3)].tolist() == [0]
    assert store.ids[store.spawn(newborns(3), 4)].tolist() == [5, 6, 7]
    living = store.ids[store.alive].tolist()
    assert len(living) == len(set(living)) == 8


def test_each_of_a_batch_has_its_own_tier_as_far_as_there_is_room() -> None:
    store = Gaussians(3, torch.device("cpu"))
    store.homeless[:] = True
    tiers = torch.tensor([int(t) for t in (Tier.RIGID, Tier.TRANSIENT, Tier.TRANSIENT, Tier.STATIC)], dtype=torch.uint8)
    homeless = torch.tensor([False, True, False, False])
    rows = store.spawn(replace(newborns(4), tiers=tiers, homeless=homeless), 1)
    assert store.tiers[rows].tolist() == tiers[:3].tolist()
    assert store.homeless[rows].tolist() == [False, True, False]


def descend(store: Gaussians, rows: torch.Tensor, gradient: torch.Tensor, rate: float) -> None:
    """One step, stored."""
    descent = store.descent(rows)
    descent.step(gradient, torch.full_like(gradient, rate))
    descent.end()


def test_a_non_finite_step_is_not_taken() -> None:
    store = Gaussians(3, torch.device("cpu"))
    rows = store.spawn(newborns(3), 1)
    before = store.values.clone()
    gradient = torch.ones(3, 14)
    gradient[1, 4] = torch.nan
    descend(store, rows, gradient, 0.01)
    assert torch.equal(store.values[1], before[1])
    assert not torch.equal(store.values[0], before[0])
    assert store.refused == 1
    descend(store, rows, torch.ones(3, 14), 0.01)
    assert torch.isfinite(store.values).all()
    assert store.refused == 1


def test_steps_keep_colours_and_sizes_in_bounds() -> None:
    store = Gaussians(2, torch.device("cpu"))
    rows = store.spawn(newborns(2), 1)
    for _ in range(50):
        descend(store, rows, -torch.ones(2, 14), 0.2)
    assert store.values[:, RGB].max() == 1
    largest = 0.01 * np.exp(LARGEST)
    assert store.values[:, LOG_SCALE].exp().max() == pytest.approx(largest, rel=1e-5)
    for _ in range(100):
        descend(store, rows, torch.ones(2, 14), 0.2)
    assert store.values[:, RGB].min() == 0
    assert store.values[:, LOG_SCALE].exp().min() > 4e-4


def test_what_nothing_pulls_at_keeps_what_is_out_of_bounds() -> None:
    """Before a camera that is near newborns may be smaller than steps make any: they grew without a step."""
    store = Gaussians(2, torch.device("cpu"))
    rows = store.spawn(newborns(2), 0)
    store.values[rows, LOG_SCALE] = -9.0
    before, gradient = store.values.clone(), torch.zeros(2, 14)
    gradient[1] = 1.0
    descent = store.descent(rows)
    descent.step(gradient, torch.full((2, 14), 1e-3))
    descent.end()
    assert torch.equal(store.values[0], before[0])
    assert (store.values[1] != before[1]).any()


def moving_world() -> tuple[Gaussians, Motion]:
    """Four STATIC Gaussians and a turned node."""
    store, nodes = Gaussians(6, torch.device("cpu")), Nodes(3, 4)
    store.spawn(newborns(4), 1)
    nodes.give_birth(torch.tensor([0.5, 0.2, 0.1], dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
    nodes.quats[0] = quat_from_vector(torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64))
    field = HexPlane(torch.full((3,), -5.0), torch.full((3,), 5.0), 4)
    motion = Motion(nodes, field)
    motion.slide(0)
    return store, motion


def test_boarding_a_node_moves_nothing_until_the_node_does() -> None:
    store, motion = moving_world()
    rows = torch.arange(4)
    before = motion.place(store, rows, motion.poses([0.0]), [0])
    store.board(rows[:2], torch.zeros(2, dtype=torch.int64), motion.nodes)
    after = motion.place(store, rows, motion.poses([0.0]), [0])
    assert torch.allclose(before.means, after.means, atol=1e-6)
    assert torch.allclose(before.quats, after.quats, atol=1e-6)
    assert store.tiers[:4].tolist() == [Tier.RIGID, Tier.RIGID, Tier.STATIC, Tier.STATIC]
    motion.nodes.positions[0, 2] += 1
    moved = motion.place(store, rows, motion.poses([0.0]), [0])
    assert torch.allclose(moved.means[0, :2, 2], after.means[0, :2, 2] + 1, atol=1e-6)
    assert torch.equal(moved.means[0, 2:], after.means[0, 2:])


def test_the_field_bends_the_deformable_and_nobody_else() -> None:
    store, motion = moving_world()
    store.board(torch.tensor([0, 1]), torch.zeros(2, dtype=torch.int64), motion.nodes)
    rigid = motion.place(store, torch.arange(4), motion.poses([0.0]), [0])
    motion.nodes.tiers[0] = int(Tier.DEFORMABLE)
    store.tiers[:2] = int(Tier.DEFORMABLE)
    neutral = motion.place(store, torch.arange(4), motion.poses([0.0]), [0])
    assert torch.allclose(rigid.means, neutral.means, atol=1e-7)
    with torch.no_grad():
        motion.field.time[:, :, 0] = 1.7
    bent = motion.place(store, torch.arange(4), motion.poses([0.0]), [0])
    assert (bent.means - rigid.means)[0, :2].abs().max() > 1e-6
    assert torch.equal(bent.means[0, 2:].detach(), rigid.means[0, 2:])


def test_a_gradient_reaches_canonical_means_and_the_field() -> None:
    store, motion = moving_world()
    store.board(torch.tensor([0, 1]), torch.zeros(2, dtype=torch.int64), motion.nodes)
    motion.nodes.tiers[0] = int(Tier.DEFORMABLE)
    store.tiers[:2] = int(Tier.DEFORMABLE)
    rows = torch.tensor([0, 1])
    values = store.values[rows].requires_grad_()
    some = replace(store.population(rows, motion.nodes), values=values)
    placed = motion.place_population(some, motion.poses([0.0, -0.01]), [0, 0])
    placed.means[..., 2].sum().backward()
    assert values.grad is not None and values.grad[:, MEAN].abs().min() > 0
    before = motion.field.time.detach().clone()
    motion.descend()
    assert not torch.equal(motion.field.time.detach(), before)


def test_the_compiled_library_places_as_torch_does() -> None:
    if not splat.has_kernels(torch.device("cpu")):
        pytest.skip("the compiled library is not at hand")
    store, motion = moving_world()
    store.board(torch.tensor([0, 1]), torch.zeros(2, dtype=torch.int64), motion.nodes)
    motion.nodes.quats[0] = quat_from_vector(torch.tensor([0.3, -1.2, 0.7], dtype=torch.float64))
    rows = torch.tensor([0, 2, 1, 3])
    some = store.population(rows, motion.nodes)
    poses, stamps = motion.poses([0.0, -0.02]), motion.stamps([0.0, -0.02])
    with torch.no_grad():
        plain, compiled = motion.place_reference(some, poses, stamps), motion.place_population(some, poses, stamps)
        from_store = motion.place(store, rows, poses, stamps)
    for name, values in vars(plain).items():
        assert torch.allclose(getattr(compiled, name), values, atol=1e-5), name
        assert torch.equal(getattr(from_store, name), getattr(compiled, name)), name


def test_what_is_hidden_has_less_influence_than_what_shows() -> None:
    store = Gaussians(3, torch.device("cpu"))
    store.steps[:2] = 5
    store.moment2[0, RGB] = 1.0
    influence = store.influence(torch.arange(3))
    assert influence[0] > influence[1] == 0 and torch.isinf(influence[2])


def test_a_row_named_twice_is_refused() -> None:
    store = Gaussians(4, torch.device("cpu"))
    with pytest.raises(ValueError, match="found 1 twice"):
        store.descent(torch.tensor([0, 2, 0]))


def test_what_boards_is_no_longer_doubted() -> None:
    """What a node carries is elsewhere: what refuted it where it was says nothing more."""
    store, nodes, place = Gaussians(2, torch.device("cpu")), Nodes(1, 2), torch.zeros(3, dtype=torch.float64)
    rows, refuted = store.spawn(newborns(2), 0), torch.ones(2, dtype=torch.bool)
    store.doubt(rows, refuted, 3)
    node = nodes.give_birth(place, place)
    store.board(rows[:1], torch.tensor([node]), nodes)
    store.doubt(rows, refuted, 3)
    assert store.doubt(rows, refuted, 3).tolist() == [False, True]
