"""Which parts of a body belong to its neighbour: those that look like it, and move as it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.model.cells import Cells
from twin_node.model.decisions import LogEvidence
from twin_node.model.looks import hues, mean_hues
from twin_node.model.velocity_equations import PARAMETERS, VelocityEquations, judge, misfits, stacked
from twin_node.scene import Bool, Float64


@dataclass(frozen=True)
class Passing:
    """Part of one node belongs to another."""

    node: int
    """Row of the node that it leaves."""
    to: int
    """Row of the node that it joins."""
    leaving: Bool
    """[c] which of the cells of the set leave."""
    grounds: LogEvidence
    """`one`: of both as they are; `two`: of both when it has passed."""


@dataclass(frozen=True)
class _Parts:
    """What k nodes carry that looks like a neighbour of theirs."""

    nodes: NDArray[np.int64]
    """[k] rows of the nodes."""
    to: NDArray[np.int64]
    """[k] rows of the neighbours."""
    cells: Bool
    """[k, c] which cells it is."""

    def of(self, chosen: Bool) -> _Parts:
        """Those `chosen` [k]."""
        return _Parts(self.nodes[chosen], self.to[chosen], self.cells[chosen])


def passings(
    said: VelocityEquations, cells: Cells, near: NDArray[np.int64], middles: Float64, usual: float
) -> Sequence[Passing]:
    """Parts of nodes that are better explained as parts of their neighbours, the surest first.

    What was `said` of each of the cells [c] decides; `near` [p, 2] are pairs of cells of different nodes that touch,
    `middles` [M, 3] m those of the nodes, `usual` is the variance of the errors elsewhere. Where pushed and pusher move
    alike the Gaussians that are born between them join either; when they part, each body gets what is its own.
    """
    parts = _alike(cells, near, len(middles))
    part = said.gathered(parts.cells)
    rest = said.gathered((cells.nodes == parts.nodes[:, None]) & ~parts.cells)
    told = (part.counts > PARAMETERS) & (rest.counts > PARAMETERS)
    if not told.any():
        return []
    parts, at = parts.of(told), (middles[parts.nodes] + middles[parts.to])[told] / 2
    rows = np.flatnonzero(told)
    others = said.gathered(cells.nodes == parts.to[:, None])
    noise = misfits(part.of(rows), at, usual)
    part = part.of(rows).over(noise)
    rest, other = (one.over(misfits(one, at, usual)) for one in (rest.of(rows), others))
    judged = judge(stacked(rest.plus(part), other, rest, other.plus(part)), np.tile(at, (4, 1)))
    whole, without, left, joined = judged.best.reshape(4, -1)
    stays, goes = whole + without, left + joined
    at_rest = judged.at_rest.reshape(4, -1)[:2].sum(0)
    return [
        Passing(
            int(parts.nodes[i]),
            int(parts.to[i]),
            parts.cells[i],
            LogEvidence(float(stays[i]), float(goes[i]), float(at_rest[i]), float(noise[i])),
        )
        for i in np.argsort(stays - goes, kind="stable")
        if goes[i] > stays[i]
    ]


def _alike(cells: Cells, near: NDArray[np.int64], count: int) -> _Parts:
    """Cells that touch a neighbour of their node's and look more like it than like their own; `count` rows of nodes."""
    touching = np.concatenate([near, near[:, ::-1]])
    cell, own, other = touching[:, 0], cells.nodes[touching[:, 0]], cells.nodes[touching[:, 1]]
    looks, means = hues(cells.rgb)[cell], mean_hues(cells.rgb, cells.nodes, count)
    like = np.square(looks - means[other]).sum(1) < np.square(looks - means[own]).sum(1)
    pairs, of = np.unique((own * count + other)[like], return_inverse=True)
    belongs = np.zeros((len(pairs), len(cells)), bool)
    belongs[of.reshape(-1), cell[like]] = True
    return _Parts(*np.divmod(pairs, count), belongs)
