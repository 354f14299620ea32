"""Which Gaussians move as one: nodes take the velocities that the flow speaks of, merge, and split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from twin_node.model.cells import Cells
from twin_node.model.creep import Creep
from twin_node.model.decisions import Decision, LogEvidence
from twin_node.model.gaussians import Gaussians
from twin_node.model.merge_split import MergeSplit
from twin_node.model.nodes import FORETOLD_NS, Nodes
from twin_node.model.normal_equations import NormalEquations
from twin_node.model.regrouping import Carried, regroup
from twin_node.model.usual_pace import USUAL_PERIOD_S
from twin_node.model.velocity_equations import PARAMETERS, PoseEquations
from twin_node.scene import Float64, Tier

SHORTEST_S = 1e-3
"""Sets nearer in time than this tell no velocity, s."""
DECIDED_S = 0.06
"""Time between decisions about which nodes are one, s: half of what they have to be agreed on for."""


class Bodies:
    """Keeps the nodes of one model at one per body."""

    def __init__(self, gaussians: Gaussians, nodes: Nodes) -> None:
        self._gaussians = gaussians
        self._nodes = nodes
        self._merge_split = MergeSplit()
        self._creep = Creep(gaussians.capacity)
        self._undecided_s = 0.0
        self._period_s = 0.0
        """From the set before the last one to that, s."""
        self.decided_s = 0.0
        """Time that the last `regroup` has decided about, s; 0 where it has put decisions off."""

    @property
    def resting(self) -> Mapping[int, LogEvidence]:
        """By row, the nodes that did not move in the time that was decided about last."""
        learned = self._nodes.alive & (self._nodes.tiers != int(Tier.ROBOT))
        return {row: grounds for row, grounds in self._merge_split.resting.items() if bool(learned[row])}

    def moved(self, rows: Tensor, cells: Cells) -> Float64:
        """[c, 6] m and rad that each cell of Gaussians `rows` [m] has moved since the set before, as is foretold.

        Called once per set, before its nodes are corrected.
        """
        moved = self._nodes.moved.numpy()[cells.nodes]
        moved[:, :3] += self._creep.of(self._gaussians, rows, cells, self._nodes)
        return moved

    def accumulate(self, cells: Cells, moved: Float64, said: NormalEquations, dt_s: float) -> None:
        """Takes note of what the flow under the cells, which have `moved`, says before it has moved the nodes.

        `dt_s`: time since the set before. How fast things were on average over a pause says little of how fast they
        are, nor whether they rested meanwhile: it counts as what is told over the time between the two sets before, or
        over the usual one.
        """
        part, sums = slice(PARAMETERS), said.sums
        origins = self._nodes.positions.numpy()[cells.nodes]
        one = PoseEquations(sums.H[:, part, part], sums.g[:, part], sums.squares, said.count, origins, moved)
        told, counted_s = one.velocity_equations(max(dt_s, SHORTEST_S)), dt_s
        if dt_s * 1e9 > FORETOLD_NS:
            counted_s = min(max(self._period_s, USUAL_PERIOD_S), dt_s)
            told = told.faded((counted_s / dt_s) ** 2)
        self._merge_split.accumulate(cells, told, dt_s)
        self._undecided_s += counted_s
        self._period_s = dt_s

    def go_on(self, cells: Cells) -> None:
        """Nodes take over the velocities that were heard of; called once they stand where this set has them."""
        nodes, learned = self._nodes, self._nodes.learned_rows.numpy()
        known = learned[np.bincount(cells.nodes, minlength=nodes.capacity)[learned] > 0]
        velocities = self._merge_split.velocities(known, nodes.positions.numpy()[known])
        nodes.set_velocities(torch.from_numpy(known), velocities[:, :3], velocities[:, 3:])

    def regroup(self, carried: Carried | None) -> Sequence[Decision]:
        """Merges and splits nodes by what was said up to now, where that is due.

        `carried` are those that the last set spoke of; None: it spoke of nobody.
        """
        self.decided_s = 0.0
        if carried is None or self._undecided_s < DECIDED_S:
            return []
        self.decided_s, self._undecided_s = self._undecided_s, 0.0
        return regroup(self._gaussians, carried, self._nodes, self._merge_split, self.decided_s)
