"""What was found of tensors is sought anew once they have been written to, and in every copy of them."""

from __future__ import annotations

import pickle

import torch
from test_gaussians import newborns

from twin_node.model.field import HexPlane
from twin_node.model.gaussians import Gaussians
from twin_node.model.motion import Motion
from twin_node.model.nodes import Nodes
from twin_node.model.writes import Writes
from twin_node.scene import Tier


def test_every_write_is_told_of_once() -> None:
    writes, first, second = Writes(), torch.zeros(3), torch.zeros(3)
    assert writes.have_come(first, second), "nobody has looked yet"
    assert not writes.have_come(first, second)
    for written in (first, second):
        written[1] = 1
        assert writes.have_come(first, second)
        assert not writes.have_come(first, second)


def test_a_copy_shows_none_of_those_that_ended_since_it_was_asked_last() -> None:
    gaussians, nodes = Gaussians(2, torch.device("cpu")), Nodes(2, 4)
    motion = Motion(nodes, HexPlane(torch.full((3,), -1.0), torch.ones(3), 2))
    nowhere = torch.zeros(3, dtype=torch.float64)
    row = nodes.give_birth(nowhere, nowhere, Tier.DEFORMABLE)
    born = gaussians.spawn(newborns(2), 1)
    assert (len(nodes.learned_rows), motion.bends, len(gaussians.static_rows)) == (1, True, 2)
    nodes.retire(torch.tensor([row]))
    gaussians.retire(born[:1])
    theirs, copy = pickle.loads(pickle.dumps((motion, gaussians)))
    assert (len(theirs.nodes.learned_rows), theirs.bends, len(copy.static_rows)) == (0, False, 1)
