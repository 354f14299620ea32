"""Which Gaussians are named as showing nowhere, round by round, and what the window held of them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from model_scenes import rig

from twin_node.model import unseen as unseen_module
from twin_node.model.gaussians import Gaussians, Newborns
from twin_node.model.nodes import Nodes
from twin_node.model.past import Past
from twin_node.model.unseen import Unseen
from twin_node.scene import Camera, Tier

CAMERA = rig()[:1]
ROWS = torch.arange(5)


def five(tier: Tier = Tier.STATIC) -> Gaussians:
    """A store of five Gaussians."""
    store, plain = Gaussians(5, torch.device("cpu")), torch.full((5, 3), 0.5)
    quats = torch.tensor([[1.0, 0, 0, 0]]).expand(5, -1)
    store.spawn(Newborns(plain, quats, plain, plain[:, 0], plain, tier, torch.full((5,), -1)), 0)
    return store


def named(unseen: Unseen, weights: list[float], bodies: list[int] | None = None) -> list[int]:
    """Rows that have not shown for long, after a round of one camera that sees them with `weights`."""
    unseen.know(CAMERA)
    assert unseen.due(CAMERA) == 0
    of = None if bodies is None else torch.tensor(bodies)
    return unseen.take(CAMERA[0], ROWS, torch.tensor(weights), of).tolist()


def test_what_showed_in_the_round_before_and_does_not_now_is_named() -> None:
    unseen = Unseen(five(), 0.1, 1)
    assert named(unseen, [1.0, 1.0, 1.0, 1.0, 0.0]) == [4]
    assert named(unseen, [0.0, 1.0, 1.0, 1.0, 1.0]) == [0]


def test_a_hidden_part_counts_where_its_body_shows_or_it_has_none() -> None:
    unseen = Unseen(five(), 0.1, 1)
    assert named(unseen, [0.0, 0.0, 0.0, 0.0, 1.0], [-1, 0, 5, 6, 6]) == [0, 3]


def test_a_round_waits_for_a_camera_that_was_there_of_late_though_another_has_left_for_good(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(unseen_module, "AWAY_SETS", 3)
    there, other, late = rig()
    left = replace(late, name="left")
    unseen, shown = Unseen(five(), 0.1, 1), torch.ones(5)

    def next_of(*cameras: Camera) -> str | None:
        unseen.know(cameras)
        index = unseen.due(cameras)
        if index is None:
            return None
        unseen.take(cameras[index], ROWS, shown)
        return cameras[index].name

    assert next_of(there, other, late, left) == there.name
    assert next_of(other, late) == other.name
    assert [next_of(there) for _ in range(4)] == [None] * 4, "one has left for good by now, the other may come back"
    assert [next_of(there) for _ in range(2)] == [there.name] * 2, "that one has left too, and the next round begins"


def test_a_set_of_the_same_stamp_takes_no_further_place_in_the_past() -> None:
    store, nodes = five(), Nodes(1, 2)
    past = Past(store, 1, 2)
    for stamp, x in ((0, 0.0), (1, 1.0), (1, 2.0), (1, 3.0)):
        nodes.stamp = stamp
        nodes.remember()
        store.values[:, 0] = x
        past.remember(store, nodes)
    assert [float(past.at(stamp, nodes).population.values[0, 0]) for stamp in (0, 1)] == [0.0, 3.0]
