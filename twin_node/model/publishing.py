"""The model as the records that other rooms read."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from twin_node.model.gaussians import LOGIT, Gaussians
from twin_node.model.motion import Motion
from twin_node.model.nodes import Nodes, Poses
from twin_node.model.rotations import rotate
from twin_node.scene import GaussianCloud, NodeStates, Tier


class Publisher:
    """Makes clouds of a model; what stands still is made ready once and kept for as long as it does."""

    def __init__(self) -> None:
        self._version = -1
        self._still: GaussianCloud | None = None

    def cloud(self, gaussians: Gaussians, motion: Motion) -> GaussianCloud:
        """All living Gaussians at the nodes' stamp, STATIC ones first; `nodes` are rows of `node_states_of`."""
        if self._still is None or self._version != gaussians.static_version:
            self._still = _part(gaussians, motion, gaussians.static_rows)
            self._version = gaussians.static_version
        moving = _part(gaussians, motion, torch.nonzero(gaussians.alive & (gaussians.tiers != int(Tier.STATIC)))[:, 0])
        return self._still.joined(moving)


def _part(gaussians: Gaussians, motion: Motion, rows: Tensor) -> GaussianCloud:
    """Some rows as a cloud."""
    carrier = gaussians.nodes[rows].cpu()
    nodes = motion.nodes
    with torch.no_grad():
        here = Poses(nodes.positions[None], nodes.quats[None])
        splats = motion.place(gaussians, rows, here, [nodes.stamp])
    means = splats.means[0].cpu()
    velocities = torch.zeros_like(means)
    carried = torch.nonzero(carrier >= 0)[:, 0]
    if len(carried):
        row = carrier[carried]
        arm = means[carried].double() - nodes.positions[row]
        turned = torch.linalg.cross(nodes.angular_velocities[row], arm)
        velocities[carried] = (nodes.velocities[row] + turned).float()
    position_of = torch.full((nodes.capacity + 1,), -1, dtype=torch.int64)
    published = learned_rows(nodes)
    position_of[published] = torch.arange(len(published))
    return GaussianCloud(
        means.numpy(),
        splats.quats[0].cpu().numpy(),
        splats.scales.cpu().numpy(),
        splats.opacities.cpu().numpy(),
        splats.rgb.clamp(0, 1).cpu().numpy(),
        velocities.numpy(),
        gaussians.tiers[rows].cpu().numpy(),
        gaussians.ids[rows].cpu().numpy().astype(np.uint32),
        position_of[carrier].numpy().astype(np.int32),
    )


def learned_rows(nodes: Nodes) -> Tensor:
    """[m] rows of the living nodes whose motion is learned: the arm's links follow its joints instead."""
    return nodes.rows[nodes.tiers[nodes.rows] != int(Tier.ROBOT)]


def node_states_of(gaussians: Gaussians, nodes: Nodes) -> NodeStates:
    """Nodes whose motion is learned, each at the opacity-weighted centroid of the Gaussians it carries."""
    alive = learned_rows(nodes)
    carried = gaussians.moving_rows
    carrier = gaussians.nodes[carried]
    carried, carrier = carried[carrier >= 0], carrier[carrier >= 0].cpu()
    local = gaussians.means[carried].cpu().double()
    weight = gaussians.values[carried, LOGIT.start].cpu().double().sigmoid()
    total = torch.zeros(nodes.capacity, dtype=torch.float64).index_add_(0, carrier, weight)
    centroid = torch.zeros(nodes.capacity, 3, dtype=torch.float64).index_add_(0, carrier, local * weight[:, None])
    centroid = centroid / total.clamp_min(1e-9)[:, None]
    radii = torch.zeros(nodes.capacity, dtype=torch.float64)
    radii.scatter_reduce_(0, carrier, (local - centroid[carrier]).norm(dim=-1), "amax")
    arm = rotate(nodes.quats, centroid)
    positions = nodes.positions + arm
    velocities = nodes.velocities + torch.linalg.cross(nodes.angular_velocities, arm)
    return NodeStates(
        nodes.ids[alive].numpy().astype(np.uint32),
        positions[alive].numpy(),
        nodes.quats[alive].numpy(),
        velocities[alive].numpy(),
        nodes.angular_velocities[alive].numpy(),
        nodes.sigmas[alive].numpy(),
        radii[alive].numpy(),
    )
