"""The merge and split tests: which of the bodies that nodes carry are one and which are two, weighed by the flow.

Two touching parts that look alike are one body until their motion says otherwise; of others motion has to say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin_node.model.cells import Cells
from twin_node.model.decisions import LogEvidence
from twin_node.model.looks import LIKE, mean_hues
from twin_node.model.parts import halves_of, lie_apart, redealt
from twin_node.model.passing import Passing, passings
from twin_node.model.velocity_equations import (
    VelocityEquations,
    judge,
    misfits,
    misfits_of,
    nothing,
    stacked,
    usual_misfit,
    velocities_of,
)
from twin_node.scene import Bool, Float64

MEMORY_S, RECENT_S = 0.2, 0.05
"""Times in which what was said fades to 1/e: for telling bodies apart, whose velocities change alike, and for telling
how fast they are, where every set more is a delay."""
MERGE, SPLIT = 2.0, 12.0
"""Nats by which one body, and by which two, must explain what was said better; apart, so that nodes do not flicker."""
MOVES = 10.0
"""Nats by which moving together must explain it better than resting, of what looks unlike: what rests together says
nothing of that."""
LOOKS = 3.0
"""Nats for one body where both look alike: twenty to one."""
STRAINED = 6.0
"""Nats by which one body may fit worse than two, parameters left aside: noise alone gives 3 for 6 of them."""
AGREED_S = 0.1
"""For how long two nodes must be found to be one before they are merged."""
DOUBT, PACE = -6.0, 1.0
"""Nats that speak for two bodies under which another way to see them is looked for: at first, and more per decision, so
that a cut which tells nothing, nor is refuted, does not stand in the way of a better one."""
NEAR_M = 0.08
"""Two nodes are neighbours where some of their cells are this near, m: a cell and the gaps between."""
SEARCHES = 4
"""Nodes per decision of which a way to see them as two bodies is looked for."""


@dataclass(frozen=True)
class Merge:
    """Two nodes are one body."""

    kept: int
    """Row of the node that goes on: the one more is known of."""
    ended: int
    """Row of the node whose Gaussians it takes over."""
    grounds: LogEvidence


@dataclass(frozen=True)
class Split:
    """One node is two bodies."""

    node: int
    """Its row."""
    leaving: Bool
    """[c] which of the cells of the set leave it."""
    grounds: LogEvidence


@dataclass
class _Suspicion:
    """That a node is two bodies."""

    second: NDArray[np.int64]
    """[k] keys of the cells that are the smaller one's."""
    one: float = 0.0
    """Evidence, since it arose, that there is one body."""
    two: float = 0.0
    """Evidence that there are two."""
    doubt: float = DOUBT
    """Nats that must speak for it by now."""


Regrouping = Merge | Split | Passing
"""What can be decided about who carries what."""


class MergeSplit:
    """Remembers what was said of cells, and finds nodes to be merged or split.

    A split is judged prequentially: the parts are found in what was said before, and what comes then tells whether two
    motions foretell it better than one, so that no choice among many ways to cut a body has to be paid for.
    """

    def __init__(self) -> None:
        self._said = nothing(0)
        self.resting: dict[int, LogEvidence] = {}
        """By row, the nodes that were seen when it was decided last, and seen not to move."""
        self._before = nothing(0)
        """What had been said when it was decided last, as it has faded since."""
        self._recent = nothing(0)
        self._cells = Cells.none()
        self._misfits = np.ones(0)
        self._usual = 1.0
        self._agreed: dict[tuple[int, int], float] = {}
        self._suspicions: dict[int, _Suspicion] = {}
        self._turn = 0

    def accumulate(self, cells: Cells, said: VelocityEquations, dt_s: float) -> None:
        """Takes in what a set said of `cells`, `dt_s` after the one before; cells that are gone are forgotten."""
        at = cells.found_in(self._cells)
        self._before = _faded(self._before, at, dt_s / MEMORY_S)
        self._said = _faded(self._said, at, dt_s / MEMORY_S).plus(said)
        self._recent = _faded(self._recent, at, dt_s / RECENT_S).plus(said)
        self._cells = cells

    def decide(self, ids: NDArray[np.int64], dt_s: float) -> Sequence[Regrouping]:
        """What to merge, split and pass on by what was said in the `dt_s` since the last decision; no node is in two.

        `ids` [M] are those of the nodes.
        """
        if not len(self._cells):
            self.resting = {}
            return []
        count = int(self._cells.nodes.max()) + 1
        said, middles = self._said.summed(self._cells.nodes, count), self._cells.middles(count)
        alike = judge(said, middles)  # as if all errors had the variance that the flow claims
        self._usual = usual_misfit(said.counts, alike)
        self._misfits = misfits_of(said.counts, alike, self._usual)
        judged = judge(said.over(self._misfits), middles)
        self.resting = {
            int(row): LogEvidence(
                float(judged.evidence[row]), -np.inf, float(judged.at_rest[row]), float(self._misfits[row])
            )
            for row in np.flatnonzero(judged.at_rest > judged.evidence)
        }
        splits = self._splits(ids, middles)
        taken = {one.node for one in splits}
        decided: list[Regrouping] = [*splits]
        near = _touching(self._cells)
        for part in passings(self._said, self._cells, near, middles, self._usual):
            if taken.isdisjoint((part.node, part.to)):
                taken |= {part.node, part.to}
                decided.append(part)
        agreed: dict[tuple[int, int], float] = {}
        for one in self._merges(said, middles, near):
            key = (int(ids[min(one.kept, one.ended)]), int(ids[max(one.kept, one.ended)]))
            agreed[key] = self._agreed.get(key, 0.0) + dt_s
            if agreed[key] > AGREED_S and taken.isdisjoint((one.kept, one.ended)):
                taken |= {one.kept, one.ended}
                decided.append(one)
        self._agreed = agreed
        self._search(ids)
        self._before = self._said
        return decided

    def velocity_of(self, chosen: Bool, point: Float64) -> Float64:
        """[6] m/s and rad/s at `point` [3] (m) of the cells `chosen` [c] as one body, by what was said of late."""
        said = self._recent.of(np.flatnonzero(chosen))
        one = said.summed(np.zeros(len(said), np.int64), 1)
        velocity: Float64 = velocities_of(one, point[None])[0]
        return velocity

    def velocities(self, rows: NDArray[np.int64], points: Float64) -> Float64:
        """[n, 6] m/s and rad/s at `points` [n, 3] m of nodes `rows` [n], by what was said of late."""
        count = int(max(self._cells.nodes.max(initial=-1), rows.max(initial=-1))) + 1
        return velocities_of(self._recent.summed(self._cells.nodes, count).of(rows), points)

    def _merges(self, said: VelocityEquations, middles: Float64, near: NDArray[np.int64]) -> list[Merge]:
        """Pairs of neighbours that one motion explains better than two, the surest first."""
        first, second = np.sort(self._cells.nodes[near], axis=1).T
        pairs = np.stack(np.divmod(np.unique(first * len(middles) + second), len(middles)), 1)
        if not len(pairs):
            return []
        a, b = (said.of(rows).over(self._misfits[rows]) for rows in pairs.T)
        at = (middles[pairs[:, 0]] + middles[pairs[:, 1]]) / 2
        misfit = self._misfits[pairs].max(1)
        judged = judge(stacked(a.plus(b), a, b), np.tile(at, (3, 1)))
        one, *each = judged.best.reshape(3, -1)
        two, at_rest = each[0] + each[1], judged.at_rest[: len(pairs)]
        fits = judged.fit.reshape(3, -1)
        strained = fits[1] + fits[2] - fits[0] > STRAINED
        looks = mean_hues(self._cells.rgb, self._cells.nodes, len(middles))[pairs]
        alike = np.linalg.norm(looks[:, 0] - looks[:, 1], axis=1) < LIKE
        good = (one - two + LOOKS * alike > MERGE) & (alike | (one - at_rest > MOVES)) & ~strained
        order = np.flatnonzero(good)[np.argsort(-(one - two)[good], kind="stable")]
        kept = np.where(a.counts >= b.counts, pairs[:, 0], pairs[:, 1])
        return [
            Merge(
                int(kept[i]),
                int(pairs[i].sum() - kept[i]),
                LogEvidence(float(one[i]), float(two[i]), float(at_rest[i]), float(misfit[i])),
            )
            for i in order
        ]

    def _splits(self, ids: NDArray[np.int64], middles: Float64) -> list[Split]:
        """Nodes that two motions have foretold better than one."""
        cells, count = self._cells, len(middles)
        rows = [int(row) for row in np.unique(cells.nodes) if int(ids[row]) in self._suspicions]
        if not rows:
            self._suspicions = {}
            return []
        second = np.zeros(len(cells), bool)
        for row in rows:
            second |= (cells.nodes == row) & cells.are_among(self._suspicions[int(ids[row])].second)
        bodies = cells.nodes + count * second
        sums = [said.summed(bodies, 2 * count) for said in (self._said, self._before)]
        firsts, seconds = np.array(rows), np.array(rows) + count
        own = [misfits(sums[0].of(part), middles[firsts], self._usual) for part in (firsts, seconds)]
        groups = [
            both.of(part).over(noise) for both in sums for part, noise in zip((firsts, seconds), own, strict=True)
        ]
        whole = [groups[0].plus(groups[1]), groups[2].plus(groups[3])]
        judged = judge(stacked(*groups, *whole), np.tile(middles[firsts], (6, 1)))
        now_first, now_second, then_first, then_second, now, then = judged.best.reshape(6, -1)
        at_rest = judged.at_rest.reshape(6, -1)[4]
        suspicions: dict[int, _Suspicion] = {}
        found = []
        for i, row in enumerate(rows):
            suspicion = self._suspicions[int(ids[row])]
            suspicion.two += float(now_first[i] + now_second[i] - then_first[i] - then_second[i])
            suspicion.one += float(now[i] - then[i])
            suspicion.doubt += PACE
            if suspicion.two - suspicion.one <= SPLIT:
                suspicions[int(ids[row])] = suspicion
                continue
            leaving = self._cut(row, second)
            if leaving is not None:
                grounds = LogEvidence(suspicion.one, suspicion.two, float(at_rest[i]), float(self._misfits[row]))
                found.append(Split(row, leaving, grounds))
        self._suspicions = suspicions
        return found

    def _cut(self, row: int, second: Bool) -> Bool | None:
        """[c] which cells leave the node in `row`, by all that has been said up to now; `second` [c] were suspected.

        None where they do not lie apart.
        """
        own = np.flatnonzero(self._cells.nodes == row)
        part = redealt(self._said.of(own), self._cells.centres[own], second[own], float(self._misfits[row]))
        if not lie_apart(self._cells.centres[own], part[None])[0]:
            return None
        leaving = np.zeros(len(second), bool)
        leaving[own] = part
        return leaving

    def _search(self, ids: NDArray[np.int64]) -> None:
        """Looks for ways to see nodes in turn as two bodies, and for better ones than those that are suspected."""
        self._turn += 1
        for row in np.roll(np.unique(self._cells.nodes), -SEARCHES * self._turn)[:SEARCHES]:
            own, suspected = np.flatnonzero(self._cells.nodes == row), None
            if self._holds(int(ids[row])):
                suspected = self._cells.are_among(self._suspicions[int(ids[row])].second)[own]
            second = halves_of(self._said.of(own), self._cells.centres[own], float(self._misfits[row]), suspected)
            if second is not None:
                self._suspicions[int(ids[row])] = _Suspicion(self._cells.keys[own[second]])

    def _holds(self, node: int) -> bool:
        """Whether a suspicion about the node with that id is still worth following."""
        suspicion = self._suspicions.get(node)
        return suspicion is not None and suspicion.two - suspicion.one > suspicion.doubt


def _faded(said: VelocityEquations, at: NDArray[np.int64], ages: float) -> VelocityEquations:
    """[n] what was said of the bodies `at` [n] (-1: nothing), `ages` time constants ago."""
    if not len(said):
        return nothing(len(at))
    share = np.where(at >= 0, np.exp(-ages), 0.0)
    return VelocityEquations(
        share[:, None, None] * said.H[at],
        share[:, None] * said.g[at],
        share * said.squares[at],
        share * said.counts[at],
    )


def _touching(cells: Cells) -> NDArray[np.int64]:
    """[p, 2] cells of different nodes that are near each other."""
    if len(cells) < 2:
        return np.zeros((0, 2), np.int64)
    tree = cKDTree(cells.centres, balanced_tree=False, compact_nodes=False)
    near = tree.query_pairs(NEAR_M, output_type="ndarray")
    between: NDArray[np.int64] = near[cells.nodes[near[:, 0]] != cells.nodes[near[:, 1]]]
    return between
