"""The live model: Gaussians that explain the newest images, and the motion that carries them there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from twin_node.model.alignment import FlowSolver, solve_twists
from twin_node.model.births import Births, find_births
from twin_node.model.deaths import refuted_moving, refuted_static, showing_stale
from twin_node.model.fitting import fit_all, fit_window
from twin_node.model.gaussians import Gaussians, Newborns
from twin_node.model.moving_mask import MovingMask
from twin_node.model.nodes import Nodes, Poses
from twin_node.model.observation import Backgrounds, Observed, Observer
from twin_node.model.parameters import ModelError, ModelParameters
from twin_node.model.publishing import cloud_of, node_states_of
from twin_node.model.rendering import Rendering, Splats, join, on_device, place, render
from twin_node.model.rotations import conjugate, quat_from_vector, quat_product, rotate
from twin_node.model.seeding import seed
from twin_node.model.sweep import shell_around
from twin_node.robot import ArmModel, robot_mask
from twin_node.scene import Bool, Camera, Float32, FrameSet, Tier, TwinState

SEED_SHARE = 0.6
"""Share of the capacity that the first set may fill: the rest is for what moves and what is uncovered."""
NEWBORN_OPACITY = 0.8


@dataclass(frozen=True)
class ModelImage:
    """The model seen by a camera."""

    rgb: Float32
    """[H, W, 3] 0 to 1."""
    depth: Float32
    """[H, W] m along the optical axis; 0 where nothing is."""
    alpha: Float32
    """[H, W] 0 to 1."""


class WindowModel:
    """Follows a scene set by set: `update` takes the newest images and returns the state they show.

    The first set is modelled whole (measured depth, or what the views agree on); after that only what moves is touched.
    Equal inputs, parameters and seed give equal bytes on a CPU: no step looks at a clock.
    """

    def __init__(self, parameters: ModelParameters | None = None, arm: ArmModel | None = None, seed: int = 0) -> None:
        self.parameters = parameters or ModelParameters()
        self._arm = arm
        self._seed = seed
        self._device = torch.device(self.parameters.device)
        self._mask = MovingMask()
        self._flow = FlowSolver()
        self._nodes = Nodes(self.parameters.nodes, self.parameters.window)
        self._gaussians = Gaussians(0, self._device)
        self._frozen: Splats | None = None
        self._backgrounds: Backgrounds | None = None
        self._observer = Observer(self.parameters.track.residual, self.parameters.birth.stale_s)
        self._static_died = False
        self._bytes_per_frame = 0

    @property
    def tier_counts(self) -> Mapping[Tier, int]:
        """Living Gaussians per tier."""
        return {tier: self._gaussians.count(tier) for tier in Tier}

    @property
    def parameters_count(self) -> int:
        """Numbers that describe the scene now: 14 per Gaussian, 6 per pose of a node in the window."""
        poses = int((self._nodes.history_stamps >= 0).sum()) * len(self._nodes.rows)
        return 14 * len(self._gaussians) + 6 * poses

    @property
    def bytes_per_frame(self) -> int:
        """Bytes that the newest set added or changed: float32 attributes of what moves or was born, node poses."""
        return self._bytes_per_frame

    def update(self, frames: FrameSet) -> TwinState:
        """Brings the model up to date with a set; raises `ModelError` for a set without views or older than the last."""
        self._check(frames)
        robots = self._robot_masks(frames)
        moving = self._mask.update(frames, robots)
        warnings: tuple[str, ...] = ()
        if self._backgrounds is None:
            self._begin(frames)
        else:
            warnings = self._track(frames, moving, robots)
        return TwinState(
            frames.stamp,
            frames,
            cloud_of(self._gaussians, self._nodes),
            node_states_of(self._gaussians, self._nodes),
            moving,
            robots,
            warnings,
        )

    def render(self, camera: Camera, stamp: int | None = None) -> ModelImage:
        """The model as `camera` sees it at `stamp` (ns, inside the window; None: the newest)."""
        poses = self._nodes.extrapolated([0.0]) if stamp is None else self._nodes.poses_at([stamp])
        rows = torch.nonzero(self._gaussians.alive)[:, 0]
        return self._shoot(self._place(rows, poses), camera)

    def render_frozen(self, camera: Camera) -> ModelImage:
        """The model as it was fitted to the first set: the baseline that every later rendering must beat."""
        if self._frozen is None:
            raise ModelError("render_frozen: no set has been seen yet; call update first")
        return self._shoot(self._frozen, camera)

    def _check(self, frames: FrameSet) -> None:
        if not frames.views:
            raise ModelError(f"set {frames.sequence}: expected at least one view, found none; check the synchroniser")
        if self._backgrounds is not None and frames.stamp < self._nodes.stamp:
            raise ModelError(
                f"set {frames.sequence}: expected a stamp of {self._nodes.stamp} ns or later, found {frames.stamp} ns; "
                "sort the source or start a new model"
            )

    def _robot_masks(self, frames: FrameSet) -> tuple[Bool | None, ...]:
        if self._arm is None or frames.joints is None:
            return (None,) * len(frames.views)
        q = self._arm.ordered_positions(frames.joints)
        return tuple(robot_mask(self._arm, q, view.camera) for view in frames.views)

    def _begin(self, frames: FrameSet) -> None:
        torch.manual_seed(self._seed)
        pixels = sum(view.camera.width * view.camera.height for view in frames.views)
        self._gaussians = Gaussians(int(pixels * self.parameters.gaussians_per_pixel), self._device)
        seeds = seed(frames.views, self.parameters.seed, int(SEED_SHARE * self._gaussians.capacity), self._device)
        self._gaussians.spawn(seeds.born, frames.stamp)
        fit_all(self._gaussians, frames.views, self.parameters.seed.steps)
        shell = shell_around([view.camera for view in frames.views], self.parameters.seed.shell_factor)
        self._backgrounds = Backgrounds(seeds.plane, shell)
        self._nodes.stamp = frames.stamp
        self._nodes.remember()
        rows = self._gaussians.static_rows
        self._frozen = self._place(rows, self._nodes.extrapolated([0.0]))
        self._bytes_per_frame = 4 * self.parameters_count

    def _track(self, frames: FrameSet, moving: tuple[Bool, ...], robots: tuple[Bool | None, ...]) -> tuple[str, ...]:
        assert self._backgrounds is not None
        dt_s = (frames.stamp - self._nodes.stamp) * 1e-9
        cameras = [view.camera for view in frames.views]
        backgrounds = self._backgrounds.of(self._gaussians, cameras)
        observed = self._observer.observe(frames, moving, robots, backgrounds, dt_s)
        good = self._gaussians.values.clone()
        self._bury_static(observed)
        self._nodes.predict(frames.stamp, self.parameters.track.velocity_damping)
        self._align(observed, dt_s)
        self._fit(observed)
        self._bury_moving(observed)
        born = self._bear(observed)
        self._end_transients()
        self._nodes.remember()
        self._bytes_per_frame = 4 * (14 * born + 7 * len(self._nodes.rows) + 3 * len(self._gaussians.moving_rows))
        return self._restore(good)

    def _align(self, observed: list[Observed], dt_s: float) -> None:
        """Node poses from the flow between the predicted rendering and the images."""
        predicted = self._nodes.extrapolated([0.0])
        for _ in range(self.parameters.track.alignments):
            rows = self._gaussians.moving_rows
            nodes = self._gaussians.nodes[rows].cpu()
            if not bool((nodes >= 0).any()):
                return
            poses = self._poses(observed)
            splats = self._place(rows, poses)
            renderings = self._look(observed, splats)
            flows = [self._flow.flow(seen, one) for seen, one in zip(renderings, observed, strict=True)]
            twists = solve_twists(
                observed,
                renderings,
                flows,
                splats.means.cpu(),
                splats.opacities.cpu(),
                nodes,
                poses.positions,
                dt_s,
                self.parameters.track.flow_sigma_px,
            )
            steered = self._nodes.rows[self._nodes.tiers[self._nodes.rows] != int(Tier.ROBOT)]
            at = self._nodes.extrapolated([0.0])
            positions = at.positions[0, steered] + twists.linear[steered]
            quats = quat_product(quat_from_vector(twists.angular[steered]), at.quats[0, steered])
            self._nodes.correct(steered, positions, quats, at, dt_s)
            self._nodes.sigmas[steered] = twists.sigmas[steered]
        del predicted

    def _fit(self, observed: list[Observed]) -> None:
        """Canonical attributes of what moves, and of STATIC ones whose place was uncovered, by a few gradient steps."""
        assert self._backgrounds is not None
        static = self._backgrounds.seen([one.view.camera for one in observed])
        chosen = torch.from_numpy(showing_stale(observed, static)).to(self._device)
        revised = self._backgrounds.rows[chosen]
        revised = revised[self._gaussians.alive[revised]]
        fit_window(self._gaussians, self._on_device(self._poses(observed)), observed, revised, self.parameters.track)
        if len(revised) or self._static_died:
            self._backgrounds.forget()

    def _bury_static(self, observed: list[Observed]) -> None:
        """STATIC Gaussians that are no longer where they were die; what left is born again where it went."""
        assert self._backgrounds is not None
        static = self._backgrounds.seen([one.view.camera for one in observed])
        gone = torch.from_numpy(refuted_static(observed, static, self.parameters.track.residual)).to(self._device)
        self._static_died = self._count_doubts(self._backgrounds.rows, gone)

    def _bury_moving(self, observed: list[Observed]) -> None:
        """Moving Gaussians that a camera sees through die, and nodes that carry nothing with them."""
        rows = self._gaussians.moving_rows
        means = self._place(rows, self._poses(observed)).means.cpu().numpy()
        gone = torch.from_numpy(refuted_moving(observed, list(means), self.parameters.track.residual))
        self._count_doubts(rows, gone.to(self._device))
        carried = torch.bincount(
            self._gaussians.nodes[self._gaussians.moving_rows].cpu() + 1, minlength=self._nodes.capacity + 1
        )[1:]
        empty = self._nodes.alive & (carried == 0) & (self._nodes.tiers != int(Tier.ROBOT))
        self._nodes.retire(torch.nonzero(empty)[:, 0])

    def _count_doubts(self, rows: Tensor, refuted: Tensor) -> bool:
        """Counts sets in a row that refute `rows`; retires those with enough. Whether any was retired."""
        doubts = (self._gaussians.doubts[rows] + 1) * refuted
        self._gaussians.doubts[rows] = doubts
        dead = rows[doubts >= self.parameters.birth.carve_sets]
        self._gaussians.retire(dead)
        return len(dead) > 0

    def _bear(self, observed: list[Observed]) -> int:
        """Gaussians and nodes for what is still unexplained; returns how many Gaussians."""
        rows = self._gaussians.moving_rows
        poses = self._poses(observed)
        renderings = self._look(observed, self._place(rows, poses))
        births = find_births(observed, renderings, self.parameters.track.residual, self.parameters.birth)
        if not len(births):
            return 0
        self._make_room(len(births))
        nodes = self._adopt(births)
        newborns = self._newborns(births, nodes, poses)
        return sum(len(self._gaussians.spawn(part, self._nodes.stamp)) for part in newborns)

    def _make_room(self, wanted: int) -> None:
        """Retires the faintest moving Gaussians where `wanted` more would pass the cap."""
        rows = self._gaussians.moving_rows
        limit = min(
            int(self.parameters.birth.moving_share * self._gaussians.capacity),
            self._gaussians.capacity - len(self._gaussians.static_rows),
        )
        excess = len(rows) + wanted - limit
        if excess > 0:
            faintest = self._gaussians.values[rows, 10].argsort(stable=True)[:excess]
            self._gaussians.retire(rows[faintest])

    def _adopt(self, births: Births) -> Tensor:
        """[n] node that carries each birth, -1 for what lies on the background; founds nodes where none is near."""
        out = np.full(len(births), -1, np.int64)
        homeless = np.nonzero(~births.on_background)[0]
        while len(homeless):
            alive = self._nodes.rows
            if len(alive):
                distance = np.linalg.norm(births.means[homeless, None] - self._nodes.positions[alive].numpy(), axis=-1)
                nearest = distance.argmin(1)
                close = distance[np.arange(len(homeless)), nearest] < self.parameters.birth.node_radius_m
                out[homeless[close]] = alive.numpy()[nearest[close]]
                homeless = homeless[~close]
            if not len(homeless) or not self._nodes.free:
                break
            reach = np.linalg.norm(births.means[homeless] - births.means[homeless[0]], axis=-1)
            group = homeless[reach < self.parameters.birth.node_radius_m]
            if len(group) >= self.parameters.birth.node_members:
                centre = torch.from_numpy(births.means[group].mean(0))
                self._nodes.give_birth(centre, torch.zeros(3, dtype=torch.float64))
                out[group] = self._nearest_row(centre)
            homeless = homeless[reach >= self.parameters.birth.node_radius_m]
        return torch.from_numpy(out)

    def _nearest_row(self, point: Tensor) -> int:
        rows = self._nodes.rows
        return int(rows[(self._nodes.positions[rows] - point).norm(dim=-1).argmin()])

    def _newborns(self, births: Births, nodes: Tensor, poses: Poses) -> list[Newborns]:
        """Births in the frames of their nodes: RIGID where a node carries them, TRANSIENT elsewhere."""
        means, view = torch.from_numpy(births.means), torch.from_numpy(births.views)
        row = nodes.clamp_min(0)
        local = rotate(conjugate(poses.quats[view, row]), means - poses.positions[view, row])
        means = torch.where(nodes[:, None] >= 0, local, means)
        out = []
        for tier, chosen in ((Tier.RIGID, nodes >= 0), (Tier.TRANSIENT, nodes < 0)):
            n = int(chosen.sum())
            quats = torch.zeros(n, 4)
            quats[:, 0] = 1
            out.append(
                Newborns(
                    means[chosen].float().to(self._device),
                    quats.to(self._device),
                    torch.from_numpy(births.radii).float()[chosen, None].repeat(1, 3).to(self._device),
                    torch.full((n,), NEWBORN_OPACITY, device=self._device),
                    torch.from_numpy(births.rgb).float()[chosen].to(self._device),
                    tier,
                    nodes[chosen].to(self._device),
                )
            )
        return out

    def _end_transients(self) -> None:
        """TRANSIENTs die of age."""
        born_before = self._nodes.stamp - round(self.parameters.birth.transient_s * 1e9)
        g = self._gaussians
        g.retire(torch.nonzero(g.alive & (g.tiers == int(Tier.TRANSIENT)) & (g.births < born_before))[:, 0])

    def _restore(self, good: Tensor) -> tuple[str, ...]:
        """Goes back to the last good values where any is not finite, and says so."""
        bad = ~torch.isfinite(self._gaussians.values).all(1) & self._gaussians.alive
        if not bool(bad.any()):
            return ()
        rows = torch.nonzero(bad)[:, 0]
        self._gaussians.values[rows] = good[rows]
        self._gaussians.forget_moments(rows)
        return (f"model: {len(rows)} Gaussians became non-finite and were set back to the last good state",)

    def _poses(self, observed: list[Observed]) -> Poses:
        return self._nodes.extrapolated([one.offset_s for one in observed])

    def _on_device(self, poses: Poses) -> Poses:
        return on_device(poses, self._device)

    def _place(self, rows: Tensor, poses: Poses) -> Splats:
        at = self._on_device(poses)
        return place(self._gaussians.values[rows], self._gaussians.nodes[rows], at.positions, at.quats)

    def _look(self, observed: list[Observed], moving: Splats) -> list[Rendering]:
        """What the views would see of the model with `moving` [C, m, ...] in it."""
        static = self._place(self._gaussians.static_rows, self._nodes.extrapolated([0.0] * len(observed)))
        with torch.no_grad():
            return render(join(static, moving), [one.view.camera for one in observed])

    def _shoot(self, splats: Splats, camera: Camera) -> ModelImage:
        with torch.no_grad():
            seen = render(splats, [camera])[0]
        return ModelImage(seen.rgb.clamp(0, 1).cpu().numpy(), seen.depth.cpu().numpy(), seen.alpha.cpu().numpy())
