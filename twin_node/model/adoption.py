"""Who carries a newborn Gaussian: the node that is near, a new one where enough are born together, or none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from twin_node.model.births import Births
from twin_node.model.gaussians import LARGEST, Gaussians, Newborns
from twin_node.model.kernels import kernels, kernels_for
from twin_node.model.node_requests import GroupRequest, NearestRequest, NewbornRequest
from twin_node.model.nodes import Nodes, Poses
from twin_node.model.rotations import conjugate, rotate
from twin_node.native_library import addresses_of
from twin_node.scene import Float32, Float64, Tier

NEWBORN_OPACITY = 0.8
KIN_M = 0.06
"""A Gaussian joins the node of the nearest one of its colour, if that is nearer than this, m; else a node is born."""
NODE_RADIUS_M = 0.12
"""Radius within which Gaussians of one colour found a node together, m."""
KIN_COLOUR = 0.15
"""Difference of colour (0 to 1, over the channels) that one kind may have at the same place: light and shade.
Another colour begins another node; whether both are one body is for their motion to tell."""
TOUCHING = 0.5
"""Share of the distance to its kind within which a point belongs to what is there, whatever its colour: texture."""
FATE = 2.0
"""Times the radius of a node within which what starts to move at once does so together."""


@dataclass(frozen=True)
class Members:
    """Gaussians that learned nodes carry: what is near one, and looks like it, is of the same kind."""

    means: Float64
    """[m, 3] m in `base_link`."""
    rgb: Float32
    """[m, 3] 0 to 1."""
    nodes: NDArray[np.int64]
    """[m] row of the node that carries each."""
    founders: NDArray[np.int64]
    """[m] id of the node that carried its kind first."""


@dataclass(frozen=True)
class Adopted:
    """Who carries n points."""

    nodes: NDArray[np.int64]
    """[n] row of the node, -1 for none."""
    founders: NDArray[np.int64]
    """[n] id of the node that carried its kind first, -1 for none."""


Adopt = Callable[[Float64, Float32, Members, Nodes, int], Adopted]
"""Who carries points [n, 3] m of colours [n, 3]; nodes are founded where so many are together."""


def adopt(births: Births, members: Members, nodes: Nodes, fewest: int) -> Adopted:
    """Who carries each birth: nobody what lies on the background or founds no node of its own."""
    carriers = _nobody(len(births))
    off = ~births.on_background
    found = adopt_points(births.means[off], births.rgb[off], members, nodes, fewest)
    carriers.nodes[off], carriers.founders[off] = found.nodes, found.founders
    return carriers


def adopt_points(points: Float64, rgb: Float32, members: Members, nodes: Nodes, fewest: int) -> Adopted:
    """Who carries each of `points` [n, 3] of colours `rgb` [n, 3]; nodes are founded where `fewest` are together: first
    of one colour, then of any."""
    carriers = _kin(points, rgb, members)
    for places in (looks_of(points, rgb, NODE_RADIUS_M), points / NODE_RADIUS_M):
        _found_together(points, places, carriers, members, nodes, fewest)
    return carriers


def adopt_started(points: Float64, rgb: Float32, members: Members, nodes: Nodes, fewest: int) -> Adopted:
    """The same of what started to move in one set: one body where it is near, whatever its colour, until its motion
    says otherwise."""
    carriers = _kin(points, rgb, members)
    _found_together(points, points / (FATE * NODE_RADIUS_M), carriers, members, nodes, fewest)
    return carriers


def _nobody(count: int) -> Adopted:
    return Adopted(np.full(count, -1, np.int64), np.full(count, -1, np.int64))


def _kin(points: Float64, rgb: Float32, members: Members) -> Adopted:
    """What is near enough to a member and looks like it, or touches one, is carried with that."""
    carriers = _nobody(len(points))
    if not len(members.nodes) or not len(points):
        return carriers
    touching_m = TOUCHING * KIN_M
    for places, own in (
        (looks_of(points, rgb, KIN_M), looks_of(members.means, members.rgb, KIN_M)),
        (points / touching_m, members.means / touching_m),
    ):
        without = np.flatnonzero(carriers.nodes < 0)
        closest = nearest(places[without], own)
        kin, closest = without[closest >= 0], closest[closest >= 0]
        carriers.nodes[kin], carriers.founders[kin] = members.nodes[closest], members.founders[closest]
    return carriers


def nearest(places: Float64, own: Float64) -> NDArray[np.int64]:
    """[n] the row of `own` [m, d] nearest to each of `places` [n, d] that is within 1 of it; -1 without one."""
    library = kernels()
    if library is None:
        return nearest_reference(places, own)
    at, columns = np.ascontiguousarray(places), np.ascontiguousarray(own.T)
    found = np.empty(len(at), np.int64)
    library.run(NearestRequest(len(at), *own.shape, *addresses_of(at, columns, found)))
    return found


def nearest_reference(places: Float64, own: Float64) -> NDArray[np.int64]:
    """The same by a tree: the reference of the compiled kernel."""
    if not len(places):
        return np.zeros(0, np.int64)
    around = np.flatnonzero(((own > places.min(0) - 1) & (own < places.max(0) + 1)).all(1))
    if not len(around):
        return np.full(len(places), -1, np.int64)
    tree = cKDTree(own[around], balanced_tree=False, compact_nodes=False)
    apart, nearest = tree.query(places, distance_upper_bound=1.0)
    return np.where(np.isfinite(apart), around[np.minimum(nearest, len(around) - 1)], -1)


def _found_together(
    points: Float64, looks: Float64, carriers: Adopted, members: Members, nodes: Nodes, fewest: int
) -> None:
    """Founds nodes for those of `points` [n, 3] that nobody carries, where enough `looks` [n, d] are within 1."""
    homeless = np.nonzero(carriers.nodes < 0)[0]
    groups = grouped(looks[homeless])
    for number in np.flatnonzero(np.bincount(groups) >= fewest):
        if not nodes.free:
            return
        group = homeless[groups == number]
        row = _found(torch.from_numpy(points[group].mean(0)), members, nodes)
        carriers.nodes[group], carriers.founders[group] = row, int(nodes.ids[row])


def grouped(places: Float64) -> NDArray[np.int64]:
    """[n] numbers of groups, in order: of the first of `places` [n, d] in none, and of all in none within 1 of it."""
    library = kernels()
    if library is None:
        return grouped_reference(places)
    at, groups = np.ascontiguousarray(places), np.empty(len(places), np.int64)
    library.run(GroupRequest(*at.shape, *addresses_of(at, groups)))
    return groups


def grouped_reference(places: Float64) -> NDArray[np.int64]:
    """The same in NumPy: the reference of the compiled kernel."""
    groups, left, number = np.full(len(places), -1, np.int64), np.arange(len(places)), 0
    while len(left):
        close = np.square(places[left] - places[left[0]]).sum(-1) < 1.0
        groups[left[close]], left, number = number, left[~close], number + 1
    return groups


def looks_of(points: Float64, rgb: Float32, reach_m: float) -> Float64:
    """[n, 6] place and colour, in units of how far both may lie from what is of the same kind; columns lie together."""
    looks = np.empty((6, len(points)))
    looks[:3], looks[3:] = points.T / reach_m, rgb.T / KIN_COLOUR
    return looks.T


def _found(centre: Tensor, members: Members, nodes: Nodes) -> int:
    """A new node, moving as those with Gaussians within twice `NODE_RADIUS_M` do."""
    apart = np.linalg.norm(members.means - centre.numpy(), axis=-1)
    neighbours = torch.from_numpy(np.unique(members.nodes[apart < 2 * NODE_RADIUS_M]))
    velocity = nodes.velocities[neighbours].mean(0) if len(neighbours) else torch.zeros(3, dtype=torch.float64)
    return nodes.give_birth(centre, velocity)


def store(births: Births, adopted: Adopted, poses: Poses, nodes: Nodes, gaussians: Gaussians) -> Tensor:
    """Stores births as `as_newborns` says, as far as there is room; returns their rows."""
    library = kernels_for(gaussians.values.device)
    if library is None:
        newborns = as_newborns(births, adopted, poses, nodes.tiers, gaussians.values.device)
        return gaussians.spawn(newborns, nodes.stamp)
    g, claimed = gaussians, gaussians.claim(len(births))
    held = [
        *(np.ascontiguousarray(births.means, np.float64), torch.from_numpy(births.radii).float().log().numpy()),
        *(np.ascontiguousarray(births.rgb, np.float32), births.on_background, births.lasting, births.views),
        *(adopted.nodes, adopted.founders),
    ]
    given = [t.contiguous() for t in (poses.positions, poses.quats, nodes.tiers, claimed.rows)]
    written = (g.values, g.moment1, g.moment2, g.steps, g.tiers, g.ids, g.nodes, g.founders, g.rested, g.births)
    pointers = (t.data_ptr() for t in (*given, *written, g.largest, g.doubts, g.homeless))
    counts = (len(births), nodes.capacity, len(claimed.rows), claimed.first_id, nodes.stamp)
    looks = (float(torch.tensor(NEWBORN_OPACITY).logit()), LARGEST, int(Tier.STATIC), int(Tier.TRANSIENT))
    library.run(NewbornRequest(*counts, *looks, *addresses_of(*held), *pointers))
    return claimed.rows


def as_newborns(births: Births, adopted: Adopted, poses: Poses, node_tiers: Tensor, device: torch.device) -> Newborns:
    """Births in the frames of their nodes, whose `poses` are those at each view's time, and of their tiers [M].

    What nodes carry comes first, then what stands in free space without one, passes over the background, or lasts.
    """
    node, free, lasting = adopted.nodes, ~births.on_background, births.lasting
    kinds = (
        (Tier.RIGID, node >= 0),
        (Tier.TRANSIENT, (node < 0) & free),
        (Tier.TRANSIENT, (node < 0) & ~free & ~lasting),
        (Tier.STATIC, (node < 0) & lasting),
    )
    chosen = [np.flatnonzero(kind) for _, kind in kinds]
    order, sizes = np.concatenate(chosen), [len(part) for part in chosen]
    tiers = np.repeat(np.array([int(tier) for tier, _ in kinds], np.uint8), sizes)
    tiers[: sizes[0]] = node_tiers.numpy()[node[chosen[0]]]
    homeless = np.repeat([False, True, False, False], sizes)
    carriers, view = torch.from_numpy(node[order]), torch.from_numpy(births.views[order])
    row, carried = carriers.clamp_min(0), carriers[:, None] >= 0
    means, quats = torch.from_numpy(births.means[order]), conjugate(poses.quats[view, row])
    local = rotate(quats, means - poses.positions[view, row])
    return Newborns(
        torch.where(carried, local, means).float().to(device),
        torch.where(carried, quats, poses.quats.new_tensor([1.0, 0, 0, 0])).float().to(device),
        torch.from_numpy(births.radii[order]).float()[:, None].repeat(1, 3).to(device),
        torch.full((len(order),), NEWBORN_OPACITY, device=device),
        torch.from_numpy(births.rgb[order]).float().to(device),
        torch.from_numpy(tiers).to(device),
        carriers.to(device),
        torch.from_numpy(homeless).to(device),
        torch.from_numpy(adopted.founders[order]).to(device),
    )
