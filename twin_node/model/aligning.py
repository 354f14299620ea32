"""Node poses by what the images show beside the rendering, and which nodes bend."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from twin_node.model.alignment import UNNOTICED_S, Twists, solve_twists
from twin_node.model.bodies import Bodies
from twin_node.model.cells import Cells, cells_of
from twin_node.model.chosen import rows_where
from twin_node.model.decisions import BendEvidence, Decision, Kind
from twin_node.model.evidence import DEMOTE, PROMOTE, Fits, accumulate, gain
from twin_node.model.flow import flows_between
from twin_node.model.gaussians import Gaussians
from twin_node.model.nodes import Nodes, Poses
from twin_node.model.observation import Observed
from twin_node.model.parameters import TrackParameters
from twin_node.model.placing import Placer
from twin_node.model.regrouping import Carried
from twin_node.model.rendering import Rendering, Splats
from twin_node.model.step_budget import Part, StepBudget
from twin_node.scene import Tier

CATCH_UPS = 2
"""Times that nodes founded or woken by a set are moved to where it shows them: the flow tells 8 pixels at a time."""


class Aligner:
    """Moves the nodes of one model to where a set shows what they carry."""

    def __init__(
        self, parameters: TrackParameters, gaussians: Gaussians, nodes: Nodes, placer: Placer, bodies: Bodies
    ) -> None:
        self._parameters = parameters
        self._gaussians = gaussians
        self._nodes = nodes
        self._placer = placer
        self._bodies = bodies
        self._decisions: list[Decision] = []

    def take_decisions(self) -> list[Decision]:
        """Which nodes have begun or ceased to bend since it was asked last."""
        taken, self._decisions = self._decisions, []
        return taken

    def follow(
        self,
        observed: Sequence[Observed],
        rows: Tensor,
        splats: Splats,
        around: Splats,
        renderings: list[Rendering],
        dt_s: float,
    ) -> tuple[list[Rendering], Carried | None]:
        """Aligns nodes by what moves, in `rows` [n]: predicted as `splats` [n], drawn behind `around` as `renderings`.

        `dt_s`: time since the set before. Returns the last renderings that nodes were aligned by, and the Gaussians
        that nodes carry; None where they carry none.
        """
        carried = rows_where(self._gaussians.nodes.index_select(0, rows) >= 0)
        if not len(carried) or not self._parameters.alignments:
            return renderings, None
        own, at = rows.index_select(0, carried), carried.cpu()
        poses = self._placer.poses(observed)
        cells = cells_of(self._gaussians, own, splats.means[0].index_select(0, carried))
        moved = self._bodies.moved(own, cells)
        twists = self._twists(observed, renderings, splats, at, cells, poses, dt_s)
        self._bodies.accumulate(cells, moved, twists.said, dt_s)
        self._weigh(twists.fits)
        self._steer(self._nodes.learned_rows, twists, dt_s)
        self._bodies.go_on(cells)
        told_of = Carried(own, cells, self._nodes.ids.clone())
        for _ in range(self._parameters.alignments - 1):
            poses = self._placer.poses(observed)
            splats = self._placer.place(rows, observed, poses)
            renderings = self._placer.look(observed, splats, around)
            twists = self._twists(observed, renderings, splats, at, cells, poses, dt_s)
            self._steer(self._nodes.learned_rows, twists, dt_s)
        return renderings, told_of

    def catch_up(self, observed: Sequence[Observed], around: Splats, dt_s: float, step_budget: StepBudget) -> None:
        """Nodes that this set has founded or woken are moved to where it shows what they carry.

        Their Gaussians stand where these stood when they were last seen to stand. Were they fitted to the images there,
        they would take on the looks of other parts of the thing, and stay behind it. `around` can stand before them;
        `dt_s`: time since the set before. Where time is short they are moved once.
        """
        nodes, rows = self._nodes, self._gaussians.moving_rows
        fresh = nodes.learned_rows[nodes.births.index_select(0, nodes.learned_rows) == nodes.stamp]
        if not len(fresh):
            return
        carried = rows_where(torch.isin(self._gaussians.nodes.index_select(0, rows), fresh.to(rows.device)))
        if not len(carried):
            return
        times = step_budget.steps(Part.CATCH_UP)
        for _ in range(times):
            poses = self._placer.poses(observed)
            splats = self._placer.place(rows, observed, poses)
            renderings = self._placer.look(observed, splats, around)
            cells = cells_of(self._gaussians, rows.index_select(0, carried), splats.means[0].index_select(0, carried))
            twists = self._twists(observed, renderings, splats, carried.cpu(), cells, poses, UNNOTICED_S)
            self._steer(fresh, twists, dt_s)
        step_budget.done(Part.CATCH_UP, times)

    def _twists(
        self,
        observed: Sequence[Observed],
        renderings: Sequence[Rendering],
        splats: Splats,
        carried: Tensor,
        cells: Cells,
        poses: Poses,
        unseen_s: float,
    ) -> Twists:
        """What the images say that nodes at `poses` are off by; for the rest see `solve_twists`."""
        flows = flows_between(renderings, observed)
        return solve_twists(observed, renderings, flows, splats, carried, cells, poses.positions, unseen_s)

    def _steer(self, steered: Tensor, twists: Twists, dt_s: float) -> None:
        """Nodes in rows `steered` [k] take their twists, of what has come since the set before, `dt_s` ago."""
        linear, angular, sigmas = (of.index_select(0, steered) for of in (twists.linear, twists.angular, twists.sigmas))
        self._nodes.correct(steered, linear, angular, dt_s)
        self._nodes.sigmas.index_copy_(0, steered, sigmas)

    def _weigh(self, fits: Fits) -> None:
        """Nodes that evidence says bend become DEFORMABLE with all they carry, those that no longer do RIGID again."""
        nodes, g = self._nodes, self._gaussians
        nodes.evidence = accumulate(nodes.evidence, fits)
        alive, tiers, evidence = (of.numpy() for of in (nodes.alive, nodes.tiers, nodes.evidence))
        bending = (tiers == int(Tier.RIGID)) & (evidence > PROMOTE) & self._parameters.bends
        stiff = (tiers == int(Tier.DEFORMABLE)) & (evidence < DEMOTE)
        changes = ((bending & alive, Tier.DEFORMABLE, Kind.BENDS), (stiff & alive, Tier.RIGID, Kind.STIFFENED))
        for chosen, tier, kind in changes:
            if chosen.any():
                rows = torch.from_numpy(chosen.nonzero()[0])
                nodes.tiers[rows] = int(tier)
                g.tiers[torch.isin(g.nodes, rows.to(g.nodes.device)) & g.alive] = int(tier)
                self._decisions += [self._decision(kind, row, fits) for row in rows.tolist()]

    def _decision(self, kind: Kind, row: int, fits: Fits) -> Decision:
        nodes = self._nodes
        terms = (fits.rigid, fits.strained, fits.count, gain(fits), nodes.evidence)
        node = int(nodes.ids[row])
        return Decision(kind, nodes.stamp, node, node, BendEvidence(*(float(term[row]) for term in terms)))
