"""What merging, splitting and passing on does to nodes and to the Gaussians that they carry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from twin_node.model.cells import Cells
from twin_node.model.decisions import Kind, LogEvidence
from twin_node.model.evidence import PROMOTE, Fits, accumulate
from twin_node.model.gaussians import MEAN, Gaussians, Newborns
from twin_node.model.merge_split import Merge, MergeSplit, Regrouping, Split
from twin_node.model.nodes import Nodes
from twin_node.model.passing import Passing
from twin_node.model.regrouping import Carried, regroup
from twin_node.model.rotations import quat_from_vector, rotate
from twin_node.model.velocity_equations import nothing
from twin_node.scene import Tier

GROUNDS = LogEvidence(0.0, 20.0, 0.0, 1.0)
ELSEWHERE = torch.tensor([[0.0, 0.0, 0.3], [0.4, 0.2, 0.3]], dtype=torch.float64)
TURNS = torch.tensor([[0.0, 0.0, 1.2], [0.5, 0.0, 0.0]], dtype=torch.float64)


@pytest.fixture
def held() -> tuple[Gaussians, Nodes, Carried]:
    """Two turned nodes that carry three Gaussians and one, all deformable."""
    nodes = Nodes(4, 4)
    rows = [nodes.give_birth(place, torch.zeros(3, dtype=torch.float64), Tier.DEFORMABLE) for place in ELSEWHERE]
    nodes.quats[rows] = quat_from_vector(TURNS)
    nodes.velocities[0] = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    store, count = Gaussians(6, torch.device("cpu")), 4
    means = torch.zeros(count, 3)
    means[:, 0] = 0.06 * torch.arange(count)
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1
    of = torch.tensor([0, 0, 0, 1])
    half = torch.full((count, 3), 0.5)
    store.spawn(Newborns(means, quats, 0.02 * half, half[:, 0], half, Tier.DEFORMABLE, of, founders=nodes.ids[of]), 0)
    centres, own = means.double().numpy(), of.numpy()
    cells = Cells(np.arange(count), own, own, np.arange(count), centres, np.full((count, 3), 0.5))
    return store, nodes, Carried(torch.arange(count), cells, nodes.ids.clone())


def places(store: Gaussians, nodes: Nodes) -> Tensor:
    """[4, 3] m in `base_link`."""
    of = store.nodes[:4]
    return rotate(nodes.quats[of], store.values[:4, MEAN].double()) + nodes.positions[of]


def done(held: tuple[Gaussians, Nodes, Carried], one: Regrouping, monkeypatch: pytest.MonkeyPatch) -> Kind:
    """Does it, and looks whether all is where it was."""
    store, nodes, carried = held
    merge_split, before = MergeSplit(), places(store, nodes)
    merge_split.accumulate(carried.cells, nothing(4), 0.03)
    monkeypatch.setattr(merge_split, "decide", lambda *_: [one])
    (decision,) = regroup(store, carried, nodes, merge_split, 0.1)
    torch.testing.assert_close(places(store, nodes), before, atol=1e-6, rtol=0)
    return decision.kind


def test_of_two_nodes_that_are_one_the_other_ends(
    held: tuple[Gaussians, Nodes, Carried], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, nodes, _ = held
    assert done(held, Merge(0, 1, GROUNDS), monkeypatch) is Kind.MERGED
    assert nodes.alive.tolist() == [True, False, False, False]
    assert store.nodes[:4].tolist() == [0] * 4
    assert store.founders[3] == nodes.ids[1], "whose kind it is stays known"


def test_what_parts_begins_turned_and_rigid_as_what_it_leaves(
    held: tuple[Gaussians, Nodes, Carried], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, nodes, _ = held
    nodes.evidence[:2] = 2 * PROMOTE
    leaving = np.array([False, False, True, False])
    assert done(held, Split(0, leaving, GROUNDS), monkeypatch) is Kind.SPLIT
    assert store.nodes[:4].tolist() == [0, 0, 2, 1]
    assert nodes.quats[2].tolist() == nodes.quats[0].tolist()
    assert nodes.positions[2].tolist() == pytest.approx([0.12, 0.0, 0.0])
    assert nodes.tiers[:3].tolist() == [Tier.RIGID, Tier.DEFORMABLE, Tier.RIGID]
    assert store.tiers[:4].tolist() == [Tier.RIGID] * 3 + [Tier.DEFORMABLE]
    unheard = Fits(*torch.zeros(3, nodes.capacity, dtype=torch.float64))
    bends = accumulate(nodes.evidence, unheard) > PROMOTE
    assert bends[:3].tolist() == [False, True, False], "it bends again at once"


def test_what_is_passed_on_has_the_node_it_goes_to_as_founder(
    held: tuple[Gaussians, Nodes, Carried], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, nodes, _ = held
    leaving = np.array([False, False, True, False])
    assert done(held, Passing(0, 1, leaving, GROUNDS), monkeypatch) is Kind.PASSED
    assert store.nodes[:4].tolist() == [0, 0, 1, 1]
    assert store.founders[:4].tolist() == nodes.ids[[0, 0, 1, 1]].tolist()


def test_no_split_is_done_without_room_for_a_node(
    held: tuple[Gaussians, Nodes, Carried], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, nodes, carried = held
    for _ in range(nodes.free):
        nodes.give_birth(torch.zeros(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
    merge_split = MergeSplit()
    monkeypatch.setattr(merge_split, "decide", lambda *_: [Split(0, np.ones(4, bool), GROUNDS)])
    assert regroup(store, replace(carried), nodes, merge_split, 0.1) == []
