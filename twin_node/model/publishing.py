"""The model as the records that other rooms read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from twin_node.model.gaussians import LOGIT, Gaussians
from twin_node.model.kernels import kernels, kernels_for
from twin_node.model.motion import Motion
from twin_node.model.node_requests import ExtentRequest, PublishRequest
from twin_node.model.nodes import Nodes, Poses
from twin_node.model.past import Moment
from twin_node.model.rendering import Splats
from twin_node.model.rotations import rotate
from twin_node.native_library import addresses_of, thread_count
from twin_node.scene import GaussianCloud, NodeStates


def cloud_of(gaussians: Gaussians, motion: Motion) -> GaussianCloud:
    """All living Gaussians at the nodes' stamp, STATIC ones first; `nodes` are rows of `node_states_of`."""
    rows, nodes = torch.cat([gaussians.static_rows, gaussians.other_rows]), motion.nodes
    library = kernels()
    if library is None or motion.bends:
        return cloud_reference(gaussians, motion, rows)
    count = len(rows)
    stored = [gaussians.values, gaussians.nodes, gaussians.ids, gaussians.tiers]
    if rows.device.type != "cpu":
        stored = [of.index_select(0, rows).cpu() for of in stored]
        rows = torch.arange(count)
    cloud = GaussianCloud(
        means=np.empty((count, 3), np.float32),
        quats=np.empty((count, 4), np.float32),
        scales=np.empty((count, 3), np.float32),
        opacities=np.empty(count, np.float32),
        rgb=np.empty((count, 3), np.float32),
        velocities=np.empty((count, 3), np.float32),
        tiers=np.empty(count, np.uint8),
        ids=np.empty(count, np.uint32),
        nodes=np.empty(count, np.int32),
    )
    given = (
        *(rows, *stored, _published(nodes)),
        *(t.contiguous() for t in (nodes.positions, nodes.quats, nodes.velocities, nodes.angular_velocities)),
    )
    written = addresses_of(*vars(cloud).values())
    pointers = (tensor.data_ptr() for tensor in given)
    library.run(PublishRequest(count, thread_count(), *pointers, *written))
    return cloud


def cloud_reference(gaussians: Gaussians, motion: Motion, rows: Tensor) -> GaussianCloud:
    """Gaussians `rows` [n] as a cloud: the reference of the compiled kernel, on any device, and for what bends."""
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
    carriers = torch.where(carrier >= 0, _published(nodes)[carrier], -1)
    return _told(splats, velocities, gaussians.tiers[rows], gaussians.ids[rows], carriers)


VELOCITY_NS = 10_000_000
"""Between two places that tell a past velocity, ns: less than from one set to the next, and far from rounding."""


def cloud_at(moment: Moment, motion: Motion) -> GaussianCloud:
    """The Gaussians of a moment of the window as a cloud; `nodes` are -1, for no nodes of then are told."""
    population = moment.population
    before = motion.nodes.poses_before(moment.stamp, VELOCITY_NS)
    with torch.no_grad():
        splats = motion.place_population(population, moment.poses, [moment.stamp])
        earlier = motion.place_population(population, before, [moment.stamp - VELOCITY_NS])
    velocities = (splats.means[0] - earlier.means[0]) / (VELOCITY_NS * 1e-9)
    return _told(splats, velocities, population.tiers, moment.ids, torch.full_like(moment.ids, -1))


def _told(splats: Splats, velocities: Tensor, tiers: Tensor, ids: Tensor, nodes: Tensor) -> GaussianCloud:
    """Gaussians [n] that are placed at one time, as others read them."""
    return GaussianCloud(
        splats.means[0].cpu().numpy(),
        torch.nn.functional.normalize(splats.quats[0].cpu(), dim=-1).numpy(),
        splats.scales.cpu().numpy(),
        splats.opacities.cpu().numpy(),
        splats.rgb.clamp(0, 1).cpu().numpy(),
        velocities.cpu().numpy(),
        tiers.cpu().numpy(),
        ids.cpu().numpy().astype(np.uint32),
        nodes.cpu().numpy().astype(np.int32),
    )


def _published(nodes: Nodes) -> Tensor:
    """[M] which of the nodes that are published each is, -1 for none."""
    position_of, published = np.full(nodes.capacity, -1, np.int64), nodes.learned_rows.numpy()
    position_of[published] = np.arange(len(published))
    return torch.from_numpy(position_of)


def node_states_of(gaussians: Gaussians, nodes: Nodes) -> NodeStates:
    """Nodes whose motion is learned, each at the opacity-weighted centroid of the Gaussians it carries."""
    alive, extents = nodes.learned_rows.numpy(), extents_of(gaussians, nodes)
    arm = rotate(nodes.quats, extents.centroids)
    positions = nodes.positions + arm
    velocities = nodes.velocities + torch.linalg.cross(nodes.angular_velocities, arm)
    shown = (positions, nodes.quats, velocities, nodes.angular_velocities, nodes.sigmas, extents.radii)
    return NodeStates(nodes.ids.numpy()[alive].astype(np.uint32), *(of.numpy()[alive] for of in shown))


@dataclass(frozen=True)
class Extents:
    """Where the Gaussians lie that M nodes carry, in the nodes' frames."""

    centroids: Tensor
    """[M, 3] m, their centroid by opacity; 0 where there are none."""
    radii: Tensor
    """[M] m, how far from there the farthest lies."""


def extents_of(gaussians: Gaussians, nodes: Nodes) -> Extents:
    """Of all nodes."""
    library = kernels_for(gaussians.values.device)
    if library is None:
        return extents_reference(gaussians, nodes)
    rows, capacity = gaussians.moving_rows, nodes.capacity
    centroids, weights, radii = (torch.empty(capacity, width, dtype=torch.float64) for width in (3, 1, 1))
    held = (rows, gaussians.nodes, gaussians.values, centroids, weights, radii)
    library.run(ExtentRequest(len(rows), capacity, *(tensor.data_ptr() for tensor in held)))
    return Extents(centroids, radii[:, 0])


def extents_reference(gaussians: Gaussians, nodes: Nodes) -> Extents:
    """The same in torch: the reference of the compiled kernel."""
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
    return Extents(centroid, radii)
