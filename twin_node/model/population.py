"""Which Gaussians there are: what images refute goes, what they show anew is born, what starts to move gets a node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from twin_node.model.adoption import Adopt, Members, adopt, adopt_points, adopt_started, store
from twin_node.model.backgrounds import Backgrounds
from twin_node.model.births import block_side
from twin_node.model.chosen import rows_where
from twin_node.model.compiled_births import find_births
from twin_node.model.compiled_deaths import judge_static, refuted_moving
from twin_node.model.deaths import Shapes, are_needed, clashing, lie_still, seen_through
from twin_node.model.decisions import Decision
from twin_node.model.gaussians import MEAN, RGB, Gaussians
from twin_node.model.motion import Motion
from twin_node.model.nodes import Poses
from twin_node.model.observation import Observed
from twin_node.model.parameters import ModelParameters
from twin_node.model.placing import Placer
from twin_node.model.pruning import MovingPruner
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering, Splats
from twin_node.model.resting import Resting
from twin_node.model.throttle import Throttle
from twin_node.model.usual_pace import usual_periods
from twin_node.scene import Tier

STANDING_JUDGED_S, MOVING_JUDGED_S = 0.06, 0.4
"""Time between two looks for what stands and has left, and for what moves and is seen through, s. Masks err for a few
sets at a time: what is taken away for that is missed until others are born and fitted."""
CARVE_LOOKS = 2
"""Looks in a row in which a camera sees through a Gaussian before it dies."""
TURNOVER = 0.05
"""Share of the Gaussians that move that newborns may replace per set where no room is left: they are guesses, and what
they replace was fitted. More of sets that are further apart than usual, as of `birth.per_set`: nodes carry less."""
ARM_LOST_S = 1.0
"""Time without joints after which an arm counts as one of the things, s: messages get lost."""
NEEDED_LIVES = 6.0
"""How many lives a TRANSIENT has while nothing else explains what depth is measured of it."""


@dataclass(frozen=True)
class Born:
    """What was born of a set."""

    gaussians: int
    woken: Sequence[Decision]
    """Nodes of what rested beside it, and why."""


class _Room(NamedTuple):
    """Room for Gaussians that move."""

    most: int
    left: int
    """Negative where there are more than `most`."""


class Population:
    """Births, deaths and boarding of one model's Gaussians."""

    def __init__(
        self,
        parameters: ModelParameters,
        gaussians: Gaussians,
        motion: Motion,
        backgrounds: Backgrounds,
        placer: Placer,
        resting: Resting,
    ) -> None:
        self._parameters = parameters
        self._gaussians = gaussians
        self._motion = motion
        self._nodes = motion.nodes
        self._backgrounds = backgrounds
        self._placer = placer
        self._resting = resting
        self._pruner = MovingPruner(gaussians)
        self._judging, self._burying = Throttle(STANDING_JUDGED_S), Throttle(MOVING_JUDGED_S)
        self._bore_at: int | None = None
        """Stamp of the set that was looked through for births last, ns."""

    def judge(self, observed: Sequence[Observed], renderings: Sequence[Rendering], arm_lost_s: float = 0.0) -> None:
        """What the images refute goes: what stands often, for what begins to move must board at once; what moves now
        and then, and so of an arm whose joints nobody has told for `arm_lost_s`."""
        if self._judging.is_due(self._nodes.stamp):
            self._judge_static(observed, renderings)
        if self._burying.is_due(self._nodes.stamp):
            self._judge_moving(observed)
            if arm_lost_s > ARM_LOST_S:
                self._judge_arm(observed)

    def prune(self, observed: Sequence[Observed], around: Splats) -> None:
        """What moves and has shown in no camera for long goes; `around` may stand before it."""
        index = self._pruner.due([one.view.camera for one in observed], self._nodes.stamp)
        if index is None:
            return
        one, rows, own = observed[index : index + 1], self._gaussians.moving_rows, slice(index, index + 1)
        moving = self._placer.place(rows, one, self._placer.poses(one))
        around = replace(around, means=around.means[own], quats=around.quats[own])
        self._pruner.look(one[0].view.camera, rows, moving, around)

    def bear(self, observed: Sequence[Observed], renderings: Sequence[Rendering]) -> Born:
        """Gaussians and nodes for what `renderings` leave unexplained; first those born without a node may find one."""
        g = self._gaussians
        self._house(rows_where(g.alive & g.homeless), adopt_points)
        room, before, self._bore_at = self._room(), self._bore_at, self._nodes.stamp
        periods = 1.0 if before is None else usual_periods((self._nodes.stamp - before) * 1e-9)
        replaced = int(min(periods * TURNOVER, 1.0) * room.most)
        wanted = min(int(periods * self._parameters.birth.per_set), max(room.left, replaced, len(observed)))
        side = block_side(sum(one.usable.size for one in observed), room.most)
        births = find_births(observed, renderings, wanted, side)
        if not len(births):
            return Born(0, ())
        roused = self._resting.rouse(births)
        self._make_room(len(births))
        adopted = adopt(births, self._members(), self._nodes, self._parameters.birth.node_members)
        if births.lasting.any():
            self._backgrounds.mark()
        stored = store(births, adopted, self._placer.poses(observed), self._nodes, self._gaussians)
        return Born(len(stored), roused)

    def _judge_static(self, observed: Sequence[Observed], renderings: Sequence[Rendering]) -> None:
        """STATIC Gaussians that have left die, those that are part of something that moves join its node.

        These at once: who waits must catch up with more.
        """
        g, evidence = self._gaussians, judge_static(observed, renderings)
        standing = rows_where(self._backgrounds.stand(g, self._backgrounds.rows))
        rows = self._backgrounds.rows.index_select(0, standing)
        clashes = clashing(observed, evidence.left, g.values[:, RGB].index_select(0, self._backgrounds.rows))
        told = (torch.from_numpy(of).to(rows.device) for of in (evidence.left, evidence.moving, clashes))
        left, moving, clash = (of.index_select(0, standing) for of in told)
        gone = g.doubt(rows, left, CARVE_LOOKS) | clash
        resting = g.rested.index_select(0, rows) >= 0  # the masks keep what has moved; it wakes when it looks otherwise
        boarding = moving & ~left & ~resting
        if bool((gone | boarding).any()):
            g.retire(rows[gone])
            self._house(rows[boarding], adopt_started)
            self._backgrounds.mark()

    def _judge_moving(self, observed: Sequence[Observed]) -> None:
        """Moving Gaussians that a camera sees through die, TRANSIENTs of age too, and nodes that carry nothing."""
        g = self._gaussians
        rows = g.moving_rows
        splats = self._placer.place(rows, observed, self._placer.poses(observed))
        radii = splats.scales.double().mean(-1).cpu().numpy()
        shapes = [Shapes(means, radii) for means in splats.means.cpu().numpy()]
        carriers = g.nodes.index_select(0, rows).cpu().numpy()
        gone = refuted_moving(observed, shapes, carriers >= 0)
        gone |= self._backgrounds.beneath(shapes[0].means.astype(np.float64), radii)
        refuted = g.doubt(rows, torch.from_numpy(gone), CARVE_LOOKS)
        age_s = (self._nodes.stamp - g.births.index_select(0, rows)).double() * 1e-9
        life_s = self._parameters.birth.transient_s
        passing = g.tiers.index_select(0, rows) == int(Tier.TRANSIENT)
        ends = refuted | (passing & (age_s > life_s))
        still = lie_still(observed, shapes)
        stands = torch.from_numpy(self._resting.has_kept_still(carriers, still)).to(rows.device)
        if bool(ends.any()):  # who is needed stays, though its rim may reach over what was learnt
            needed = torch.from_numpy(are_needed(observed, shapes)).to(rows.device)
            stands |= ends & needed & torch.from_numpy(still).to(rows.device)
            ends &= ~stands & (~needed | (passing & (age_s > NEEDED_LIVES * life_s)))
        self._resting.lay(rows.index_select(0, rows_where(stands)))
        g.retire(rows.index_select(0, rows_where(ends)))
        staying, learned = carriers[~(ends | stands).cpu().numpy()], self._nodes.learned_rows.numpy()
        members = np.bincount(staying[staying >= 0], minlength=self._nodes.capacity)
        self._nodes.retire(torch.from_numpy(learned[members[learned] == 0]))

    def _judge_arm(self, observed: Sequence[Observed]) -> None:
        """What measured depth sees through of an arm that stands where its joints were last is elsewhere by now."""
        g, rows = self._gaussians, self._gaussians.robot_rows
        splats = self._placer.place(rows, observed, self._placer.poses(observed))
        gone = np.zeros(len(rows), bool)
        for one, means in zip(observed, splats.means.cpu().numpy(), strict=True):
            gone |= seen_through(one, look(one.view.camera, means))
        g.retire(rows.index_select(0, rows_where(g.doubt(rows, torch.from_numpy(gone), CARVE_LOOKS))))

    def _house(self, rows: Tensor, carriers_of: Adopt) -> None:
        """Gaussians `rows` [n] that move but have no node become RIGID where one is near or can be founded."""
        if not len(rows):
            return
        g = self._gaussians
        own = g.values.index_select(0, rows).cpu().numpy()
        points, rgb = own[:, MEAN].astype(np.float64), own[:, RGB]
        adopted = carriers_of(points, rgb, self._members(), self._nodes, self._parameters.birth.node_members)
        housed = (adopted.nodes >= 0).nonzero()[0]
        if not len(housed):
            return
        carriers, founders = (torch.from_numpy(of[housed]) for of in (adopted.nodes, adopted.founders))
        g.board(rows.index_select(0, torch.from_numpy(housed).to(rows.device)), carriers, self._nodes, founders)

    def _members(self) -> Members:
        """The Gaussians that learned nodes carry, where these are now."""
        g, nodes = self._gaussians, self._nodes
        rows = g.moving_rows
        rows = rows.index_select(0, rows_where(g.nodes.index_select(0, rows) >= 0))
        with torch.no_grad():
            here = self._motion.place(g, rows, Poses(nodes.positions[None], nodes.quats[None]), [nodes.stamp])
        carriers, founders = (of.index_select(0, rows).cpu().numpy() for of in (g.nodes, g.founders))
        return Members(here.means[0].cpu().double().numpy(), here.rgb.cpu().numpy(), carriers, founders)

    def _room(self) -> _Room:
        """For what moves."""
        g = self._gaussians
        most = min(
            int(self._parameters.birth.moving_share * g.capacity),
            g.capacity - len(g.static_rows) - len(g.robot_rows),
        )
        return _Room(most, most - len(g.moving_rows))

    def _make_room(self, wanted: int) -> None:
        """Retires the moving Gaussians that matter least to the images where `wanted` more would pass the cap."""
        excess = wanted - self._room().left
        if excess > 0:
            rows = self._gaussians.moving_rows
            least = self._gaussians.influence(rows).argsort(stable=True)[:excess]
            self._gaussians.retire(rows[least])
