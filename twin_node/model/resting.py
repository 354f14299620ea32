"""What has come to rest for good needs no motion parameters: its Gaussians become STATIC, until it moves again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node.model.adoption import KIN_M, looks_of, nearest
from twin_node.model.backgrounds import Backgrounds
from twin_node.model.births import Births
from twin_node.model.chosen import rows_where
from twin_node.model.deaths import are_visible
from twin_node.model.decisions import BornBeside, ChangedView, Decision, Kind, LogEvidence
from twin_node.model.gaussians import RGB, Gaussians
from twin_node.model.long_rest import MOST_UNSEEN_NS, STANDS_NS, unseen_ns
from twin_node.model.nodes import Nodes
from twin_node.model.observation import Observed
from twin_node.model.quality import MOVING_THRESHOLD, largest_channel
from twin_node.model.rendering import Rendering
from twin_node.scene import Bool

REST_S = 1.0
"""For how long the images must tell no motion of a node before what it carries counts as standing, s: a hand that
holds still between two moves rests for less."""
RESTS = 6.0
"""Nats by which resting must explain the images better than moving for a set to count in full; less counts for less:
what is hardly seen is watched for longer."""
STIRRED = 0.25
"""Share of what is seen of a thing at rest that looks otherwise when it moves again: its edges do so first."""
LEAST_STIRRED = 3
"""Gaussians that must look otherwise, or be born beside it: one or two may be noise."""


class Resting:
    """Sends nodes that rest to the STATIC Gaussians, and wakes them again."""

    def __init__(self, gaussians: Gaussians, nodes: Nodes, backgrounds: Backgrounds) -> None:
        self._gaussians = gaussians
        self._nodes = nodes
        self._backgrounds = backgrounds
        self._rested_s: dict[int, float] = {}
        """Seconds for which each node, by its id, has rested."""
        self._stirred_at: dict[int, int] = {}
        """Stamp (ns) at which each node, by its id, last carried something that lay where something moves; later by
        what nobody has seen of the time since."""
        self._asked_at: int | None = None
        """Stamp (ns) of the set that was asked about last."""

    def settle(self, resting: Mapping[int, LogEvidence], dt_s: float) -> Sequence[Decision]:
        """Takes in which nodes, by row, have rested in the last `dt_s`; those that have for long end.

        Of a pause no more counts than `MOST_UNSEEN_NS`.
        """
        dt_s = min(dt_s, MOST_UNSEEN_NS * 1e-9)
        g, nodes = self._gaussians, self._nodes
        ids = {int(nodes.ids[row]): row for row in resting}
        surely = {node: min((resting[row].at_rest - resting[row].one) / RESTS, 1.0) for node, row in ids.items()}
        self._rested_s = {node: self._rested_s.get(node, 0.0) + surely[node] * dt_s for node in ids}
        ended = [node for node, rested_s in self._rested_s.items() if rested_s > REST_S]
        for node in ended:
            members = rows_where(g.alive & (g.nodes == ids[node]))
            g.settle(members, node, nodes)
            del self._rested_s[node]
        if ended:
            nodes.retire(torch.tensor([ids[node] for node in ended]))
            self._backgrounds.renew()
        return [Decision(Kind.SETTLED, nodes.stamp, node, node, resting[ids[node]]) for node in ended]

    def has_kept_still(self, carriers: NDArray[np.int64], still: Bool) -> Bool:
        """[n] whether none of what the nodes `carriers` [n] (-1: none) carry has lain where something moves for long.

        `still` [n] says which does not now. What hides it may be what it is part of, which stands by now.
        """
        stamp, ids = self._nodes.stamp, np.where(carriers >= 0, self._nodes.ids.numpy()[carriers], -1)
        unseen = 0 if self._asked_at is None else unseen_ns(self._asked_at, stamp)
        self._asked_at = stamp
        stirred_at = {node: at + unseen for node, at in self._stirred_at.items()}
        stirred = set(ids[~still].tolist())
        self._stirred_at = {
            node: stamp if node in stirred else stirred_at.get(node, stamp) for node in np.unique(ids).tolist()
        }
        kept = [node for node, at in self._stirred_at.items() if node >= 0 and stamp - at > STANDS_NS]
        return np.isin(ids, kept)

    def lay(self, rows: Tensor) -> None:
        """Gaussians `rows` [n] that moved are STATIC where they are from now on, and so for each node those it carried.

        For what images show to stand, whatever its node makes of it.
        """
        g, nodes = self._gaussians, self._nodes
        if not len(rows):
            return
        carriers = g.nodes.index_select(0, rows)
        for node in sorted(set(carriers.tolist())):
            members = rows.index_select(0, rows_where(carriers == node))
            if node >= 0:
                g.settle(members, int(nodes.ids[node]), nodes)
            else:
                g.come_to_rest(members)
        self._backgrounds.mark()

    def wake(self, observed: Sequence[Observed], renderings: Sequence[Rendering]) -> Sequence[Decision]:
        """Gives what rested and looks otherwise a node again; `renderings` tell what stands covered."""
        g, rows = self._gaussians, self._backgrounds.rows
        groups = torch.where(g.alive.index_select(0, rows), g.rested.index_select(0, rows), -1).cpu().numpy()
        at_rest = np.flatnonzero(groups >= 0)
        if not len(at_rest):
            return []
        groups = groups[at_rest]
        seen, changed = _stirred(observed, renderings, at_rest)
        grounds = {}
        for group in np.unique(groups).tolist():
            own = groups == group
            visible, stirred = int((seen & own).sum()), int((changed & own).sum())
            if stirred >= max(LEAST_STIRRED, STIRRED * visible):
                grounds[group] = ChangedView(visible, stirred)
        return self._wake(grounds)

    def rouse(self, births: Births) -> Sequence[Decision]:
        """Gives what rested a node again where something of its kind is born within `KIN_M` of it.

        What creeps looks otherwise at its edges alone. Were these left to newborns, they would hide it, come to rest
        themselves, and go on until a heap of Gaussians stood there that nobody sees and nobody wakes.
        """
        g, off = self._gaussians, ~births.on_background
        rows = rows_where(g.alive & (g.rested >= 0))
        if not len(rows) or not off.any():
            return []
        means, rgb = g.means[rows].cpu().double().numpy(), g.values[rows, RGB].cpu().numpy()
        closest = nearest(looks_of(births.means[off], births.rgb[off], KIN_M), looks_of(means, rgb, KIN_M))
        groups, counts = np.unique(g.rested[rows].cpu().numpy()[closest[closest >= 0]], return_counts=True)
        enough = counts >= LEAST_STIRRED
        counted = zip(groups[enough].tolist(), counts[enough].tolist(), strict=True)
        return self._wake({group: BornBeside(count) for group, count in counted})

    def _wake(self, grounds: Mapping[int, ChangedView | BornBeside]) -> Sequence[Decision]:
        """Nodes for what rested, by group, while there is room for nodes."""
        g, begun = self._gaussians, []
        for group, why in grounds.items():
            if self._nodes.free:
                node = self._begin(rows_where(g.alive & (g.rested == group)))
                begun.append(Decision(Kind.WOKEN, self._nodes.stamp, group, node, why))
        if begun:
            self._backgrounds.renew()
        return begun

    def _begin(self, members: Tensor) -> int:
        """A node that carries `members` [k], and its id."""
        g, nodes = self._gaussians, self._nodes
        middle = g.means[members].cpu().double().mean(0)
        row = nodes.give_birth(middle, torch.zeros(3, dtype=torch.float64))
        g.board(members, torch.full((len(members),), row), nodes)
        return int(nodes.ids[row])


def _stirred(
    observed: Sequence[Observed], renderings: Sequence[Rendering], chosen: NDArray[np.int64]
) -> tuple[Bool, Bool]:
    """Per row of the background that is `chosen` [n]: whether some view shows it, and whether one something else."""
    visible, changed = np.zeros(len(chosen), bool), np.zeros(len(chosen), bool)
    for one, rendering in zip(observed, renderings, strict=True):
        seen = one.background.static.of(chosen)
        at = (seen.rows, seen.columns)
        shown = are_visible(one, rendering, seen)
        visible |= shown
        missed = largest_channel(one.rgb[at], rendering.pixels[..., :3][at]) - one.misfit[at]
        changed |= shown & (missed > MOVING_THRESHOLD)
    return visible, changed
