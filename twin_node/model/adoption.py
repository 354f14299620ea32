"""Who carries a newborn Gaussian: the node that is near, a new one where enough are born together, or none."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node.model.births import Births
from twin_node.model.gaussians import Newborns
from twin_node.model.nodes import Nodes, Poses
from twin_node.model.parameters import BirthParameters
from twin_node.model.rotations import conjugate, rotate
from twin_node.scene import Float64, Tier

NEWBORN_OPACITY = 0.8


def adopt(births: Births, nodes: Nodes, parameters: BirthParameters) -> NDArray[np.int64]:
    """[n] row of the node that carries each birth, -1 for what lies on the background or founds no node of its own."""
    carriers = np.full(len(births), -1, np.int64)
    off = ~births.on_background
    carriers[off] = adopt_points(births.means[off], nodes, parameters)
    return carriers


def adopt_points(points: Float64, nodes: Nodes, parameters: BirthParameters) -> NDArray[np.int64]:
    """[n] row of the node that carries each of `points` [n, 3]; new nodes are founded where enough are together."""
    carriers = np.full(len(points), -1, np.int64)
    alive = nodes.rows
    if len(alive) and len(points):
        apart = np.linalg.norm(points[:, None] - nodes.positions[alive].numpy(), axis=-1)
        near = apart.min(1) < parameters.node_radius_m
        carriers[near] = alive.numpy()[apart.argmin(1)[near]]
    homeless = np.nonzero(carriers < 0)[0]
    while len(homeless) and nodes.free:
        apart = np.linalg.norm(points[homeless] - points[homeless[0]], axis=-1)
        group = homeless[apart < parameters.node_radius_m]
        if len(group) >= parameters.node_members:
            carriers[group] = _found(torch.from_numpy(points[group].mean(0)), nodes, parameters.node_radius_m)
        homeless = homeless[apart >= parameters.node_radius_m]
    return carriers


def _found(centre: Tensor, nodes: Nodes, radius_m: float) -> int:
    """A new node, moving as its neighbours within twice `radius_m` do."""
    alive = nodes.rows
    apart = (nodes.positions[alive] - centre).norm(dim=-1)
    neighbours = alive[apart < 2 * radius_m]
    velocity = nodes.velocities[neighbours].mean(0) if len(neighbours) else torch.zeros(3, dtype=torch.float64)
    return nodes.give_birth(centre, velocity)


def as_newborns(births: Births, carriers: NDArray[np.int64], poses: Poses, device: torch.device) -> list[Newborns]:
    """Births in the frames of their nodes, whose `poses` are those at each view's time, one batch per tier."""
    node = torch.from_numpy(carriers)
    view = torch.from_numpy(births.views)
    row = node.clamp_min(0)
    means = torch.from_numpy(births.means)
    local = rotate(conjugate(poses.quats[view, row]), means - poses.positions[view, row])
    quats = torch.where(node[:, None] >= 0, conjugate(poses.quats[view, row]), poses.quats.new_tensor([1.0, 0, 0, 0]))
    means = torch.where(node[:, None] >= 0, local, means)
    lasting, free = torch.from_numpy(births.lasting), torch.from_numpy(~births.on_background)
    kinds = (
        (Tier.RIGID, node >= 0, False),
        (Tier.TRANSIENT, (node < 0) & free, True),
        (Tier.TRANSIENT, (node < 0) & ~free & ~lasting, False),
        (Tier.STATIC, (node < 0) & lasting, False),
    )
    return [
        Newborns(
            means[chosen].float().to(device),
            quats[chosen].float().to(device),
            torch.from_numpy(births.radii).float()[chosen, None].repeat(1, 3).to(device),
            torch.full((int(chosen.sum()),), NEWBORN_OPACITY, device=device),
            torch.from_numpy(births.rgb).float()[chosen].to(device),
            tier,
            node[chosen].to(device),
            homeless,
        )
        for tier, chosen, homeless in kinds
        if bool(chosen.any())
    ]
