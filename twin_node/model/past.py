"""What the model held at each set of the window, so that a past stamp shows what was alive then, as it looked then."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.model.gaussians import Gaussians, Population
from twin_node.model.nodes import NEVER, Nodes, Poses


@dataclass(frozen=True)
class Moment:
    """The Gaussians and the poses of their nodes at one stamp."""

    population: Population
    ids: Tensor
    """[n] int64, of its Gaussians."""
    poses: Poses
    """At `stamp` alone."""
    stamp: int
    """ns."""


class Past:
    """A ring over the window of whole sets of Gaussians; its size is fixed, and the live model never reads it.

    Whole sets, because rows are used again as soon as a Gaussian dies, and appearance changes along the way: a copy of
    the arrays costs less than keeping book of who lived when. Node poses are the nodes' own keyframes.
    """

    def __init__(self, gaussians: Gaussians, nodes: int, window: int) -> None:
        """Room for `window` sets of all that `gaussians` and `nodes` rows of nodes can hold."""
        count, device = gaussians.capacity, gaussians.values.device
        self._stamps = torch.full((window,), NEVER, dtype=torch.int64)
        self._values = torch.zeros(window, *gaussians.values.shape, device=device)
        self._alive = torch.zeros(window, count, dtype=torch.bool, device=device)
        self._tiers = torch.zeros(window, count, dtype=torch.uint8, device=device)
        self._ids = torch.zeros(window, count, dtype=torch.int64, device=device)
        self._carriers = torch.zeros(window, count, dtype=torch.int16, device=device)
        self._anchors = torch.zeros(window, nodes, 3, dtype=torch.float64)
        self._slot = -1

    def remember(self, gaussians: Gaussians, nodes: Nodes) -> None:
        """Writes what lives at the nodes' stamp over the oldest set of the window, or over that of the same stamp."""
        if self._stamps[self._slot] != nodes.stamp:
            self._slot = (self._slot + 1) % len(self._stamps)
        slot = self._slot
        self._stamps[slot] = nodes.stamp
        self._values[slot] = gaussians.values
        self._alive[slot] = gaussians.alive
        self._tiers[slot] = gaussians.tiers
        self._ids[slot] = gaussians.ids
        self._carriers[slot] = gaussians.nodes
        self._anchors[slot] = nodes.anchors

    def at(self, stamp: int, nodes: Nodes) -> Moment:
        """What lived at the first set that is not older than `stamp` (ns), with the poses of `stamp` itself.

        Before the window that is its oldest set, after it the newest. Call it once `remember` has been.
        """
        known = torch.nonzero(self._stamps > NEVER)[:, 0]
        later = known[self._stamps[known] >= stamp]
        slot = later[self._stamps[later].argmin()] if len(later) else known[self._stamps[known].argmax()]
        rows = torch.nonzero(self._alive[slot])[:, 0]
        population = Population(
            self._values[slot, rows],
            self._tiers[slot, rows],
            self._carriers[slot, rows].long(),
            self._anchors[slot],
        )
        return Moment(population, self._ids[slot, rows], nodes.poses_at(stamp), stamp)
