"""The Gaussians: arrays of fixed capacity, an alive mask, and the optimiser state that belongs to each row."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.model.chosen import rows_where
from twin_node.model.nodes import Nodes
from twin_node.model.rendering import Splats
from twin_node.model.rotations import conjugate, quat_product, rotate
from twin_node.model.writes import Writes
from twin_node.scene import Tier
from twin_node.splat import AdamState, Bounds, Decays, adam_step, columns

MEAN, QUAT, LOG_SCALE, LOGIT, RGB = columns.MEAN, columns.QUAT, columns.LOG_SCALE, columns.LOGIT, columns.RGB
"""Columns of `Gaussians.values`."""
WIDTH = columns.WIDTH
IDS = 2**32
"""How many ids there are, as clouds tell them: enough for ten days of a crowded cell at 30 Hz, and then used again."""
SMALLEST = -7.6
"""Log of the smallest scale: half a millimetre."""
QUICK = Decays(0.65, 0.95)
"""Adam's of Gaussians that are followed by a few steps per set: where the set before pulled them to is not where this
one does, and what is farther back than five sets is of another image. With a first decay of 0.8 what moves is 0.3 dB
worse, with 0.9 1.2 dB; with 0.3 steps follow the noise. A first fit ends as well."""
LARGEST = 1.1
"""Log of how many times its size at birth a Gaussian may reach: of those that move there are few, and each stands for
what is like it around its own patch too. With 0.7 as few of them cost a recorded cell 0.8 dB; 1.5 brings no more."""


@dataclass(frozen=True)
class Newborns:
    """Gaussians about to be stored; canonical, so in the frame of `nodes` where that is not -1."""

    means: Tensor
    """[n, 3] m."""
    quats: Tensor
    """[n, 4] w, x, y, z."""
    scales: Tensor
    """[n, 3] m, linear."""
    opacities: Tensor
    """[n] 0 to 1."""
    rgb: Tensor
    """[n, 3] 0 to 1."""
    tiers: Tier | Tensor
    """[n] uint8, or that of all."""
    nodes: Tensor
    """[n] int64 row of the node that carries it, -1 for none."""
    homeless: Tensor | None = None
    """[n] whether it stands in free space without a node: the next set may find it one. None: none does."""
    founders: Tensor | None = None
    """[n] int64 id of the node that carried their kind first, -1 for none; None: none."""

    def packed(self) -> Tensor:
        """[n, 14] as the columns of `Gaussians.values`."""
        opacity = self.opacities.clamp(0.01, 0.99)[:, None]
        return torch.cat([self.means, self.quats, self.scales.log(), opacity.logit(), self.rgb], 1)


@dataclass(frozen=True)
class Claimed:
    """Room for newborns."""

    rows: Tensor
    """[n] of the store."""
    first_id: int
    """That of the first row; the others' follow."""


@dataclass(frozen=True)
class Population:
    """Some Gaussians in the frames of what carries them."""

    values: Tensor
    """[n, 14] as the columns of `Gaussians.values`."""
    tiers: Tensor
    """[n] uint8."""
    carriers: Tensor
    """[n] int64 rows of nodes, -1 for none."""
    anchors: Tensor
    """[M, 3] m, float64: where each node was born."""


def activated(values: Tensor, means: Tensor, quats: Tensor) -> Splats:
    """Gaussians with the sizes, opacities and colours of `values` [n, 14], at `means` and `quats` [T, n, ...]."""
    scales = values[:, LOG_SCALE].contiguous().exp()  # of columns as they lie it takes four times as long
    return Splats(means, quats, scales, values[:, LOGIT.start].sigmoid(), values[:, RGB])


class Gaussians:
    """Structure of arrays of fixed capacity; nothing is ever reallocated, so a long run cannot grow.

    `values` [capacity, 14] holds mean (m), quaternion (w, x, y, z), log scale (log m), opacity logit and linear colour
    in the frame of the row's node (in `base_link` where it has none).
    """

    def __init__(self, capacity: int, device: torch.device) -> None:
        self.capacity = capacity
        self.values = torch.zeros(capacity, WIDTH, device=device)
        self.values[:, QUAT.start] = 1
        self.moment1 = torch.zeros(capacity, WIDTH, device=device)
        self.moment2 = torch.zeros(capacity, WIDTH, device=device)
        self.steps = torch.zeros(capacity, dtype=torch.int64, device=device)
        self.alive = torch.zeros(capacity, dtype=torch.bool, device=device)
        self.tiers = torch.zeros(capacity, dtype=torch.uint8, device=device)
        self.ids = torch.zeros(capacity, dtype=torch.int64, device=device)
        self.nodes = torch.full((capacity,), -1, dtype=torch.int64, device=device)
        self.founders = torch.full((capacity,), -1, dtype=torch.int64, device=device)
        """Id of the node that carried its kind first: who it belongs with as long as motion does not tell."""
        self.rested = torch.full((capacity,), -1, dtype=torch.int64, device=device)
        """Id of the node that carried a STATIC Gaussian until it came to rest, -1 for others."""
        self.births = torch.zeros(capacity, dtype=torch.int64, device=device)
        self.largest = torch.zeros(capacity, device=device)
        self.doubts = torch.zeros(capacity, dtype=torch.int64, device=device)
        self.homeless = torch.zeros(capacity, dtype=torch.bool, device=device)
        self.refused = 0
        """Steps of single Gaussians that were not finite and were therefore not taken, since the model began."""
        self._next_id = 0
        self._ids_are_used_again = False
        self._rows: dict[tuple[Tier, Tier], Tensor] = {}
        self._writes = Writes()

    def __len__(self) -> int:
        return int(self.alive.sum())

    @property
    def means(self) -> Tensor:
        """[capacity, 3] canonical, m."""
        return self.values[:, MEAN]

    @property
    def static_rows(self) -> Tensor:
        """[s] rows of the Gaussians that carry no motion parameters."""
        return self._rows_of(Tier.STATIC, Tier.STATIC)

    @property
    def moving_rows(self) -> Tensor:
        """[m] rows of the Gaussians whose motion is learned: RIGID, DEFORMABLE and TRANSIENT."""
        return self._rows_of(Tier.RIGID, Tier.TRANSIENT)

    @property
    def robot_rows(self) -> Tensor:
        """[r] rows of the Gaussians that the arm carries."""
        return self._rows_of(Tier.ROBOT, Tier.ROBOT)

    @property
    def other_rows(self) -> Tensor:
        """[o] rows of all Gaussians but the STATIC ones."""
        return self._rows_of(Tier.ROBOT, Tier.TRANSIENT)

    def _rows_of(self, first: Tier, last: Tier) -> Tensor:
        """[n] rows of the living of these tiers and those between, sought anew only when lives or tiers have changed.

        A set asks for them a dozen times. Callers must not write to them.
        """
        if self._writes.have_come(self.alive, self.tiers):
            self._rows = {}
        if (first, last) not in self._rows:
            tiers, alive = self.tiers.cpu().numpy(), self.alive.cpu().numpy()
            of_them = alive & (tiers - int(first) <= int(last) - int(first))  # without a sign: those before wrap around
            self._rows[first, last] = torch.from_numpy(of_them.nonzero()[0]).to(self.alive.device)
        return self._rows[first, last]

    def population(self, rows: Tensor, nodes: Nodes) -> Population:
        """Gaussians `rows` [n] as they are now."""
        values, tiers, carriers = (of.index_select(0, rows) for of in (self.values, self.tiers, self.nodes))
        return Population(values, tiers, carriers, nodes.anchors)

    @staticmethod
    def standing(values: Tensor) -> Splats:
        """Attributes `values` [n, 14] of Gaussians without a node, as they stand in `base_link`."""
        return activated(values, values[None, :, MEAN], values[None, :, QUAT])

    def count(self, tier: Tier) -> int:
        """Living Gaussians of a tier."""
        return int((self.alive & (self.tiers == tier)).sum())

    def spawn(self, born: Newborns, stamp: int) -> Tensor:
        """Stores as many of `born` as there is room for, in order; returns their rows."""
        claimed = self.claim(len(born.means))
        free, n = claimed.rows, len(claimed.rows)
        self.values[free] = born.packed()[:n]
        self.tiers[free] = born.tiers[:n] if isinstance(born.tiers, Tensor) else int(born.tiers)
        self.nodes[free] = born.nodes[:n]
        self.rested[free] = -1
        self.founders[free] = -1 if born.founders is None else born.founders[:n]
        self.ids[free] = torch.arange(claimed.first_id, claimed.first_id + n, device=free.device)
        self.births[free] = stamp
        self.largest[free] = born.scales[:n].amax(-1).log() + LARGEST
        self.doubts[free] = 0
        self.homeless[free] = False if born.homeless is None else born.homeless[:n]
        self.forget_moments(free)
        return free

    def claim(self, count: int) -> Claimed:
        """Room for `count` newborns, or for as many as there is; they live from now on, all else is to be set."""
        rows = rows_where(~self.alive)[:count]
        first_id = self._unused(len(rows))
        self.alive[rows] = True
        self._next_id = first_id + len(rows)
        return Claimed(rows, first_id)

    def _unused(self, count: int) -> int:
        """The first of `count` ids in a row that nobody living has: from the newest on, and from 0 on after `IDS`."""
        first = self._next_id
        while True:
            if first + count > IDS:
                first, self._ids_are_used_again = 0, True
            if not self._ids_are_used_again:
                return first
            own = self.ids[self.alive & (self.ids >= first) & (self.ids < first + count)]
            if not len(own):
                return first
            first = int(own.max()) + 1

    def doubt(self, rows: Tensor, refuted: Tensor, sets: int) -> Tensor:
        """[n] which of `rows` [n] are `refuted` [n] now, and so have been for `sets` sets in a row; those that live."""
        doubts = self.doubts.index_select(0, rows).add_(1).mul_(refuted.to(rows.device))
        self.doubts.index_copy_(0, rows, doubts)
        return (doubts >= sets) & self.alive.index_select(0, rows)

    def board(self, rows: Tensor, carriers: Tensor, nodes: Nodes, founders: Tensor | None = None) -> None:
        """Gaussians `rows` [n] without a node are from now on carried by nodes `carriers` [n], whose tier they take.

        `founders` [n]: see `Gaussians.founders`; None: the carriers themselves.
        """
        device, turn = self.values.device, conjugate(nodes.quats[carriers])
        own = self.values.index_select(0, rows)
        here = own.cpu().double()
        own[:, MEAN] = rotate(turn, here[:, MEAN] - nodes.positions[carriers]).to(own)
        own[:, QUAT] = quat_product(turn, here[:, QUAT]).to(own)
        self.values.index_copy_(0, rows, own)
        self.tiers[rows] = nodes.tiers[carriers].to(device)
        self.founders[rows] = (nodes.ids[carriers] if founders is None else founders).to(device)
        self.nodes[rows] = carriers.to(device)
        self.doubts[rows] = 0
        self.rested[rows] = -1
        self.homeless[rows] = False
        self.forget_moments(rows)

    def settle(self, rows: Tensor, node: int, nodes: Nodes) -> None:
        """Gaussians `rows` [n], which the node with the id `node` carries, are STATIC where they are from now on."""
        self._alight(rows, nodes)
        self.come_to_rest(rows)
        self.rested[rows] = node

    def come_to_rest(self, rows: Tensor) -> None:
        """Gaussians `rows` [n], which no node carries, are STATIC from now on."""
        self.tiers[rows] = int(Tier.STATIC)
        self.doubts[rows] = 0
        self.homeless[rows] = False
        self.forget_moments(rows)

    def transfer(self, rows: Tensor, carriers: Tensor, nodes: Nodes) -> None:
        """Gaussians `rows` [n], which nodes carry, are from now on carried by `carriers` [n]; none moves for it."""
        self._alight(rows, nodes)
        self.board(rows, carriers, nodes, self.founders[rows])

    def _alight(self, rows: Tensor, nodes: Nodes) -> None:
        """Nobody carries `rows` [n], which nodes carried, any more: their attributes become those in `base_link`."""
        carriers, own = self.nodes[rows].cpu(), self.values.index_select(0, rows)
        turn, here = nodes.quats[carriers], own.cpu().double()
        own[:, MEAN] = (rotate(turn, here[:, MEAN]) + nodes.positions[carriers]).to(own)
        own[:, QUAT] = quat_product(turn, here[:, QUAT]).to(own)
        self.values.index_copy_(0, rows, own)
        self.nodes[rows] = -1

    def retire(self, rows: Tensor) -> None:
        """Ends the life of `rows` [n]; their slots are free again."""
        if not len(rows):
            return
        self.alive[rows] = False
        self.nodes[rows] = -1

    def influence(self, rows: Tensor) -> Tensor:
        """[n] how much the images say about the colours of `rows` [n]: the gradient's root mean square over time.

        What is hidden or fainter than its neighbours has little. Infinite for those that have not learned yet.
        """
        steps = self.steps.index_select(0, rows)
        square = self.moment2[:, RGB].index_select(0, rows).sum(-1) / (1 - QUICK.second ** steps.clamp_min(1).float())
        return torch.where(steps > 0, square.sqrt(), torch.inf)

    def forget_moments(self, rows: Tensor) -> None:
        """Zeroes the optimiser state of `rows` [n]: stale momenta move what is no longer selected (DecoGS, 4.3)."""
        self.moment1[rows] = 0
        self.moment2[rows] = 0
        self.steps[rows] = 0

    def take(self, rows: Tensor, values: Tensor, moment1: Tensor, moment2: Tensor, steps: Tensor) -> None:
        """Stores attributes [n, 14] and optimiser state of `rows` [n]."""
        self.values[rows] = values
        self.moment1[rows], self.moment2[rows], self.steps[rows] = moment1, moment2, steps

    def descent(self, rows: Tensor, decays: Decays = QUICK) -> Descent:
        """Adam steps on `rows` [n] only; what they lead to is stored by `Descent.end`.

        Raises `ValueError` where a row is named twice: which of its two results stayed would be left to chance.
        """
        if len(rows) != len(torch.unique(rows)):
            raise ValueError(f"descent: expected every row once, found {len(rows) - len(torch.unique(rows))} twice")
        return Descent(self, rows, decays)


class Descent:
    """Several steps of Adam (Kingma and Ba, 2015) on the same rows of one store."""

    def __init__(self, gaussians: Gaussians, rows: Tensor, decays: Decays) -> None:
        self._store = gaussians
        self._decays = decays
        self._rows = rows
        store, self._ceilings = gaussians, gaussians.largest[rows]
        self._state = AdamState(*(of[rows] for of in (store.values, store.moment1, store.moment2, store.steps)))
        self._refused = torch.zeros_like(self._state.steps)

    @property
    def values(self) -> Tensor:
        """[n, 14] as they are now."""
        return self._state.values

    def step(self, gradient: Tensor, rates: Tensor) -> None:
        """One step down `gradient` [n, 14] at `rates` [n, 14]; none for rows that nothing pulls at.

        Rows that would not stay finite keep their values and forget their moments.
        """
        self._state, refused = adam_step(self._state, gradient, Bounds(rates, self._ceilings, SMALLEST), self._decays)
        self._refused += refused

    def end(self) -> None:
        """Stores values and moments, and counts the steps that were not taken."""
        self._store.take(self._rows, *vars(self._state).values())
        self._store.refused += int(self._refused.sum())
