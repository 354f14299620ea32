"""Nodes merge, split and pass parts on: their Gaussians change carriers where they are."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.model.cells import Cells
from twin_node.model.chosen import rows_where
from twin_node.model.decisions import Decision, Kind
from twin_node.model.gaussians import Gaussians
from twin_node.model.merge_split import Merge, MergeSplit, Split
from twin_node.model.nodes import Nodes
from twin_node.model.passing import Passing
from twin_node.scene import Bool, Tier


@dataclass(frozen=True)
class Carried:
    """Gaussians that nodes carried when a set told of their motion; some have died since, and so have nodes."""

    rows: Tensor
    """[m] of the Gaussians."""
    cells: Cells
    """In which cells of their nodes they are."""
    ids: Tensor
    """[M] of the nodes."""

    def leavers(self, gaussians: Gaussians, node: int, leaving: Bool) -> Tensor:
        """[k] rows of those in cells that are `leaving` [c] which the node in row `node` still carries."""
        chosen = self.rows[torch.from_numpy(leaving[self.cells.of]).to(self.rows.device)]
        return chosen[gaussians.alive[chosen] & (gaussians.nodes[chosen] == node)]

    def are_there(self, nodes: Nodes, *rows: int) -> bool:
        """Whether all nodes in `rows` are still those that they were."""
        return all(bool(nodes.alive[row]) and int(nodes.ids[row]) == int(self.ids[row]) for row in rows)


def regroup(
    gaussians: Gaussians, carried: Carried, nodes: Nodes, merge_split: MergeSplit, dt_s: float
) -> list[Decision]:
    """Does what `merge_split` decides about the last `dt_s`, as far as those that it is about are still there."""
    done = []
    for one in merge_split.decide(carried.ids.numpy(), dt_s):
        if isinstance(one, Merge):
            if carried.are_there(nodes, one.kept, one.ended):
                done.append(_merge(gaussians, nodes, one))
        elif isinstance(one, Passing):
            if carried.are_there(nodes, one.node, one.to):
                done.append(_pass(gaussians, carried, nodes, one))
        elif nodes.free and carried.are_there(nodes, one.node):
            done.append(_split(gaussians, carried, nodes, merge_split, one))
    return done


def _merge(gaussians: Gaussians, nodes: Nodes, one: Merge) -> Decision:
    members = rows_where(gaussians.alive & (gaussians.nodes == one.ended))
    gaussians.transfer(members, torch.full((len(members),), one.kept), nodes)
    nodes.retire(torch.tensor([one.ended]))
    return Decision(Kind.MERGED, nodes.stamp, int(nodes.ids[one.kept]), int(nodes.ids[one.ended]), one.grounds)


def _pass(gaussians: Gaussians, carried: Carried, nodes: Nodes, one: Passing) -> Decision:
    leavers = carried.leavers(gaussians, one.node, one.leaving)
    gaussians.transfer(leavers, torch.full((len(leavers),), one.to), nodes)
    gaussians.founders[leavers] = int(nodes.ids[one.to])
    return Decision(Kind.PASSED, nodes.stamp, int(nodes.ids[one.node]), int(nodes.ids[one.to]), one.grounds)


def _split(gaussians: Gaussians, carried: Carried, nodes: Nodes, merge_split: MergeSplit, one: Split) -> Decision:
    cells = carried.cells
    staying = ~one.leaving & (cells.nodes == one.node)
    leavers = carried.leavers(gaussians, one.node, one.leaving)
    place = torch.from_numpy(cells.centres[one.leaving].mean(0))
    begun = nodes.give_birth(place, nodes.velocities[one.node], quat=nodes.quats[one.node])
    gaussians.transfer(leavers, torch.full((len(leavers),), begun), nodes)
    stayed = gaussians.founders[rows_where(gaussians.alive & (gaussians.nodes == one.node))]
    kept = torch.cat([stayed, nodes.ids[one.node : one.node + 1].to(stayed.device)])  # by the node: none has two
    gaussians.founders[leavers[torch.isin(gaussians.founders[leavers], kept)]] = int(nodes.ids[begun])
    for node, part in ((one.node, staying), (begun, one.leaving)):
        velocity = torch.from_numpy(merge_split.velocity_of(part, nodes.positions[node].numpy()))
        nodes.velocities[node], nodes.angular_velocities[node] = velocity[:3], velocity[3:]
    gaussians.tiers[rows_where(gaussians.alive & (gaussians.nodes == one.node))] = int(Tier.RIGID)
    nodes.tiers[one.node] = int(Tier.RIGID)
    nodes.evidence[one.node] = 0  # that it bends was said of both as of one body
    return Decision(Kind.SPLIT, nodes.stamp, int(nodes.ids[one.node]), int(nodes.ids[begun]), one.grounds)
