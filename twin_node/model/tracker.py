"""One set after another: node motion, the Gaussians that move, births and deaths; STATIC ones are left alone."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from twin_node.model.adoption import adopt, adopt_points, as_newborns
from twin_node.model.alignment import FlowSolver, solve_twists
from twin_node.model.backgrounds import Backgrounds, grow
from twin_node.model.births import find_births
from twin_node.model.deaths import judge_static, refuted_moving, showing_stale
from twin_node.model.evidence import DEMOTE, PROMOTE, Fits, accumulate
from twin_node.model.fitting import fit_moving, held_pixels, revise
from twin_node.model.gaussians import LOGIT, Gaussians
from twin_node.model.motion import Motion
from twin_node.model.nodes import Poses
from twin_node.model.observation import Observed, Observer
from twin_node.model.parameters import ModelParameters
from twin_node.model.rendering import Rendering, Splats, join, render
from twin_node.model.robot_links import RobotLinks
from twin_node.model.rotations import quat_from_vector, quat_product
from twin_node.model.stages import OnStage, unwatched
from twin_node.scene import Bool, FrameSet, Tier


class Tracker:
    """Keeps Gaussians and nodes up to date with the newest images; a set is `track`."""

    def __init__(
        self,
        parameters: ModelParameters,
        gaussians: Gaussians,
        motion: Motion,
        backgrounds: Backgrounds,
        links: RobotLinks | None,
    ) -> None:
        self._parameters = parameters
        self._gaussians = gaussians
        self._motion = motion
        self._nodes = motion.nodes
        self._backgrounds = backgrounds
        self._observer = Observer(parameters.track.residual, parameters.birth.stale_s)
        self._flow = FlowSolver()
        self._links = links

    def track(
        self,
        frames: FrameSet,
        moving: Sequence[Bool],
        robots: Sequence[Bool | None],
        dt_s: float,
        on_stage: OnStage = unwatched,
    ) -> int:
        """Follows `frames`, taken `dt_s` after the set before; returns how many Gaussians were born."""
        backgrounds = self._backgrounds.of(self._gaussians, [view.camera for view in frames.views])
        observed = self._observer.observe(frames, moving, robots, backgrounds, dt_s)
        on_stage("observe")
        self._nodes.predict(frames.stamp, self._parameters.track.velocity_damping)
        self._motion.slide(frames.stamp)
        if self._links is not None and frames.joints is not None:
            self._links.drive(frames.joints, dt_s)
        renderings = self._align(observed, dt_s)
        on_stage("align")
        self._judge_static(observed, renderings)
        moving_now = self._moving(observed)
        self._bury_moving(observed, moving_now)
        g = self._gaussians
        self._house(torch.nonzero(g.alive & g.homeless)[:, 0])
        on_stage("judge")
        fitted = self._fit(observed, moving_now) or renderings
        on_stage("fit")
        born = self._bear(observed, fitted)
        on_stage("bear")
        self._nodes.remember()
        return born

    def _align(self, observed: Sequence[Observed], dt_s: float) -> list[Rendering]:
        """Node poses from the flow between the predicted rendering and the images; returns the last rendering."""
        splats = self._moving(observed)
        renderings = self._look(observed, splats)
        for step in range(self._parameters.track.alignments):
            rows = self._gaussians.moving_rows
            nodes = self._gaussians.nodes[rows].cpu()
            if not bool((nodes >= 0).any()):
                break
            if step:
                splats = self._moving(observed)
                renderings = self._look(observed, splats)
            flows = [self._flow.flow(seen, one) for seen, one in zip(renderings, observed, strict=True)]
            origins = self._poses(observed).positions
            sigma_px = self._parameters.track.flow_sigma_px
            twists = solve_twists(observed, renderings, flows, splats, nodes, origins, dt_s, sigma_px)
            steered = self._nodes.rows[self._nodes.tiers[self._nodes.rows] != int(Tier.ROBOT)]
            at = self._nodes.extrapolated([0.0])
            positions = at.positions[0, steered] + twists.linear[steered]
            quats = quat_product(quat_from_vector(twists.angular[steered]), at.quats[0, steered])
            self._nodes.correct(steered, positions, quats, at, dt_s)
            self._nodes.sigmas[steered] = twists.sigmas[steered]
            if step == 0:
                self._weigh(twists.fits)
        return renderings

    def _weigh(self, fits: Fits) -> None:
        """Nodes that evidence says bend become DEFORMABLE with all they carry, those that no longer do RIGID again."""
        nodes, g = self._nodes, self._gaussians
        nodes.evidence = accumulate(nodes.evidence, fits)
        bending = (nodes.tiers == int(Tier.RIGID)) & (nodes.evidence > PROMOTE)
        stiff = (nodes.tiers == int(Tier.DEFORMABLE)) & (nodes.evidence < DEMOTE)
        for chosen, tier in ((bending, Tier.DEFORMABLE), (stiff, Tier.RIGID)):
            rows = torch.nonzero(chosen & nodes.alive)[:, 0]
            if len(rows):
                nodes.tiers[rows] = int(tier)
                g.tiers[torch.isin(g.nodes, rows.to(g.nodes.device)) & g.alive] = int(tier)

    def _judge_static(self, observed: Sequence[Observed], renderings: Sequence[Rendering]) -> None:
        """STATIC Gaussians that have left die, those that are part of something that moves join its node."""
        evidence = judge_static(observed, renderings, self._parameters.track.residual)
        doubted = self._doubted(self._backgrounds.rows, torch.from_numpy(evidence.left | evidence.moving))
        left = torch.from_numpy(evidence.left).to(doubted.device)
        self._gaussians.retire(self._backgrounds.rows[doubted & left])
        self._house(self._backgrounds.rows[doubted & ~left])
        if bool(doubted.any()):
            self._backgrounds.mark()

    def _house(self, rows: Tensor) -> None:
        """Gaussians `rows` [n] that move but have no node become RIGID where one is near or can be founded."""
        points = self._gaussians.means[rows].cpu().double().numpy()
        carriers = torch.from_numpy(adopt_points(points, self._nodes, self._parameters.birth))
        housed = carriers >= 0
        self._gaussians.board(rows[housed.to(rows.device)], carriers[housed], self._nodes)

    def _fit(self, observed: Sequence[Observed], moving: Splats) -> list[Rendering]:
        """Canonical attributes of what moves by a few gradient steps, and of STATIC Gaussians whose look has changed.

        Returns what the views saw before the last of them; empty where nothing moves.
        """
        masks = held_pixels(observed, moving)
        self._revise(observed)
        before = self._before(observed, moving)
        return fit_moving(self._gaussians, self._motion, observed, masks, before, self._parameters.track)

    def _revise(self, observed: Sequence[Observed]) -> None:
        if not self._backgrounds.due or not any(one.stale.any() for one in observed):
            return
        chosen = torch.from_numpy(showing_stale(observed)).to(self._gaussians.alive.device)
        revised = self._standing(self._backgrounds.rows[chosen])
        if len(revised):
            backgrounds, masks = [one.background for one in observed], [grow(one.stale, 1) for one in observed]
            near = self._standing(self._backgrounds.near(backgrounds, masks))
            revise(self._gaussians, self._motion, observed, near, revised, self._parameters.track)
            self._backgrounds.mark()

    def _bury_moving(self, observed: Sequence[Observed], splats: Splats) -> None:
        """Moving Gaussians that a camera sees through die, TRANSIENTs of age too, and nodes that carry nothing."""
        g = self._gaussians
        rows = g.moving_rows
        radii = splats.scales.mean(-1).cpu().numpy()
        carried = (g.nodes[rows] >= 0).cpu().numpy()
        gone = refuted_moving(observed, list(splats.means.cpu().numpy()), radii, carried)
        gone |= self._backgrounds.beneath(splats.means[0].cpu().double().numpy(), radii)
        g.retire(rows[self._doubted(rows, torch.from_numpy(gone))])
        born_before = self._nodes.stamp - round(self._parameters.birth.transient_s * 1e9)
        g.retire(torch.nonzero(g.alive & (g.tiers == int(Tier.TRANSIENT)) & (g.births < born_before))[:, 0])
        members = torch.bincount(g.nodes[g.moving_rows].cpu() + 1, minlength=self._nodes.capacity + 1)[1:]
        empty = self._nodes.alive & (members == 0) & (self._nodes.tiers != int(Tier.ROBOT))
        self._nodes.retire(torch.nonzero(empty)[:, 0])

    def _bear(self, observed: Sequence[Observed], renderings: Sequence[Rendering]) -> int:
        """Gaussians and nodes for what `renderings` leave unexplained; returns how many Gaussians."""
        births = find_births(observed, renderings, self._parameters.track.residual, self._parameters.birth)
        if not len(births):
            return 0
        self._make_room(len(births))
        carriers = adopt(births, self._nodes, self._parameters.birth)
        if births.lasting.any():
            self._backgrounds.mark()
        newborns = as_newborns(births, carriers, self._poses(observed), self._gaussians.values.device)
        rows = torch.cat([self._gaussians.spawn(part, self._nodes.stamp) for part in newborns])
        carried = rows[self._gaussians.nodes[rows] >= 0]
        tiers = self._nodes.tiers[self._gaussians.nodes[carried].cpu()]
        self._gaussians.tiers[carried] = tiers.to(carried.device)
        return len(rows)

    def _make_room(self, wanted: int) -> None:
        """Retires the faintest moving Gaussians where `wanted` more would pass the cap."""
        rows = self._gaussians.moving_rows
        room = self._gaussians.capacity - len(self._gaussians.static_rows)
        limit = min(int(self._parameters.birth.moving_share * self._gaussians.capacity), room)
        excess = len(rows) + wanted - limit
        if excess > 0:
            faintest = self._gaussians.values[rows, LOGIT.start].argsort(stable=True)[:excess]
            self._gaussians.retire(rows[faintest])

    def _doubted(self, rows: Tensor, refuted: Tensor) -> Tensor:
        """[n] which of `rows` [n] have been refuted for enough sets in a row, this one included."""
        doubts = (self._gaussians.doubts[rows] + 1) * refuted.to(rows.device)
        self._gaussians.doubts[rows] = doubts
        return (doubts >= self._parameters.birth.carve_sets) & self._gaussians.alive[rows]

    def _before(self, observed: Sequence[Observed], moving: Splats) -> Tensor:
        """Rows that nothing is learned about and that can stand before what moves: STATIC ones, and the arm."""
        backgrounds = [one.background for one in observed]
        before = self._backgrounds.occluders(backgrounds, list(moving.means.cpu().double().numpy()))
        return torch.cat([self._standing(before), self._gaussians.robot_rows])

    def _standing(self, rows: Tensor) -> Tensor:
        """Those of the background's rows that still live and stand: others have boarded a node in this very set."""
        g = self._gaussians
        return rows[g.alive[rows] & (g.tiers[rows] == int(Tier.STATIC))]

    def _poses(self, observed: Sequence[Observed]) -> Poses:
        """The nodes at each view's own time."""
        return self._motion.poses([one.offset_s for one in observed])

    def _moving(self, observed: Sequence[Observed]) -> Splats:
        """What moves, at each view's own time."""
        return self._place(self._gaussians.moving_rows, observed)

    def _place(self, rows: Tensor, observed: Sequence[Observed]) -> Splats:
        offsets = [one.offset_s for one in observed]
        with torch.no_grad():
            return self._motion.place(self._gaussians, rows, self._poses(observed), self._motion.stamps(offsets))

    def _look(self, observed: Sequence[Observed], moving: Splats) -> list[Rendering]:
        """What the views would see of the model with `moving` in it; beyond their active pixels the background."""
        before = self._place(self._before(observed, moving), observed)
        masks, backdrops = [one.active for one in observed], [one.background.backdrop for one in observed]
        with torch.no_grad():
            return render(join(before, moving), [one.view.camera for one in observed], masks, backdrops)
