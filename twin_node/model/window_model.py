"""The live model: Gaussians that explain the newest images, and the motion that carries them there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from twin_node.model.aligning import CATCH_UPS
from twin_node.model.arm_mask import robot_masks
from twin_node.model.arm_sight import ArmSight
from twin_node.model.backgrounds import Backgrounds
from twin_node.model.balance import balance_joining
from twin_node.model.decisions import Decision
from twin_node.model.devices import usable_device
from twin_node.model.exposure import Exposures, Levelled
from twin_node.model.far_depth import FarDepth, wild_depth
from twin_node.model.field import HexPlane
from twin_node.model.first_light import FirstLight
from twin_node.model.fitting import fit_all
from twin_node.model.gaussians import Gaussians
from twin_node.model.motion import Motion
from twin_node.model.moving_mask import MovingMask
from twin_node.model.nodes import NEVER, Nodes
from twin_node.model.parameters import ModelError, ModelParameters
from twin_node.model.past import Moment, Past
from twin_node.model.publishing import cloud_at, cloud_of, node_states_of
from twin_node.model.rendering import Splats, render
from twin_node.model.robot_links import RobotLinks, arm_depth, links_of
from twin_node.model.seeding import Seeds, seed
from twin_node.model.stages import LeftS, OnStage, Proceed, endless, unhurried, unwatched
from twin_node.model.step_budget import Part, StepBudget
from twin_node.model.sweep import Shell, shell_around
from twin_node.model.tracker import Tracker
from twin_node.robot import ArmModel
from twin_node.scene import Bool, Camera, Exposure, Float32, FrameSet, GaussianCloud, NodeStates, Tier, TwinState, View
from twin_node.splat.library import torch_alone

SEED_SHARE = 0.6
"""Share of the capacity that the first set may fill: the rest is for what moves and what is uncovered."""


@dataclass(frozen=True)
class ModelImage:
    """The model seen by a camera."""

    rgb: Float32
    """[H, W, 3] 0 to 1."""
    depth: Float32
    """[H, W] m along the optical axis; 0 where nothing is."""
    alpha: Float32
    """[H, W] 0 to 1."""


@dataclass(frozen=True)
class _Shown:
    """The model as it is shown."""

    stamp: int
    """Of the set that it follows, ns."""
    gaussians: GaussianCloud
    nodes: NodeStates


@dataclass(frozen=True)
class _Begun:
    """What there is from the first set on."""

    motion: Motion
    tracker: Tracker
    past: Past
    frozen: Splats
    """The first set's, as they were fitted to it."""


class WindowModel:
    """Follows a scene set by set: `update` takes the newest images and returns the state they show.

    The first set is modelled whole (measured depth, or what the views agree on); after that only what moves is touched.
    Equal inputs, parameters and seed give equal bytes on a CPU: no step looks at a clock.
    """

    def __init__(self, parameters: ModelParameters | None = None, arm: ArmModel | None = None, seed: int = 0) -> None:
        """Raises `ModelError` where there are fewer nodes than links of the arm, or no such device."""
        self.parameters = parameters or ModelParameters()
        if arm is not None and self.parameters.nodes < len(links_of(arm)):
            raise ModelError(
                f"nodes: expected {len(links_of(arm))} or more, one for each link of the arm, found "
                f"{self.parameters.nodes}; leave it out, or raise it"
            )
        self._arm = arm
        self._seed = seed
        self._device = usable_device(self.parameters.device)
        self._mask = MovingMask(arm)
        self._nodes = Nodes(self.parameters.nodes, self.parameters.window)
        self._gaussians = Gaussians(0, self._device)
        self._begun: _Begun | None = None
        self._light = FirstLight()
        self._far_depth: FarDepth | None = None
        """None before the first set."""
        self._arm_sight = ArmSight(arm)
        self._exposures = Exposures()
        self._step_budget = StepBudget({Part.CATCH_UP: CATCH_UPS, Part.FIT: self.parameters.track.steps})
        self._newest: _Shown | None = None
        """None before the first set has been followed."""
        self._looked_at = 0
        """Stamp of the set that was looked at last, ns."""
        self._bytes_per_frame = 0
        self.decisions: Sequence[Decision] = ()
        """Which nodes have merged, split and come to rest since the `update` before the last one, or were woken, found
        to bend or found to be stiff by that, and what spoke for it."""
        self.on_stage: OnStage = unwatched
        """Told of every stage of an update that has ended, for measurements."""

    def __getstate__(self) -> dict[str, Any]:
        """What a copy in another process goes on with, as this one would: slices of work that have begun come to their
        end first."""
        if self._begun is not None:
            with torch_alone():
                self._begun.tracker.end()
        return vars(self)

    @property
    def tier_counts(self) -> Mapping[Tier, int]:
        """Living Gaussians per tier."""
        tiers, alive = (of.cpu().numpy() for of in (self._gaussians.tiers, self._gaussians.alive))
        return dict(zip(Tier, np.bincount(tiers[alive], minlength=len(Tier)).tolist(), strict=True))

    @property
    def capacity(self) -> int:
        """Gaussians that there is room for; fixed by the first set."""
        return self._gaussians.capacity

    @property
    def nodes_count(self) -> int:
        """Living motion nodes, the arm's links among them."""
        return len(self._nodes.rows)

    @property
    def hurried(self) -> int:
        """Sets that took fewer steps so as to be out in time."""
        return self._step_budget.hurried

    @property
    def parameters_count(self) -> int:
        """Numbers that describe the scene now: 14 per Gaussian, 6 per node and set of the window, the field if used."""
        poses = int((self._nodes.history_stamps > NEVER).sum()) * len(self._nodes.rows)
        motion = None if self._begun is None else self._begun.motion
        field = motion.field.parameters_count if motion is not None and motion.bends else 0
        return 14 * len(self._gaussians) + 6 * poses + field

    @property
    def bytes_per_frame(self) -> int:
        """Bytes that the newest set added or changed: float32 attributes of what moves or was born, node poses."""
        return self._bytes_per_frame

    def update(self, frames: FrameSet, left_s: LeftS = endless) -> TwinState:
        """Brings the model up to date with a set: `look` at it, and `follow` what it shows.

        Raises what these raise.
        """
        return self.follow(self.look(frames), left_s)

    def look(self, frames: FrameSet) -> TwinState:
        """What a set shows, with the model of the set before: its images levelled, and what moves in them.

        A forecast of what measured depth shows needs no more, and has it long before the model. The first set is
        modelled whole at once. Raises `ModelError` for a set without views, with two of one camera, or older than the
        last, with images that are not of their camera's size, or with depth that is negative or not finite, and
        `RobotError` for joints of another arm.
        """
        self._check(frames)
        begun, is_first = self._begun, self._begun is None
        far_depth = self._far_depth = self._far_depth or FarDepth([view.camera for view in frames.views])
        frames = far_depth.without(frames)
        frames = self._light.begin(frames) if is_first else self._light.heed(frames, self._mask.is_still)
        robots = robot_masks(self._arm, frames)
        self._arm_sight.heed(frames)
        if begun is None:
            begun, levelled = self._begin(frames, robots)
        else:
            levelled = self._exposures.level(frames, robots, self._exposure_of)
        frames = levelled.frames
        self.on_stage("level")
        moving = self._mask.update(frames, robots)
        self._exposures.heed(frames, moving)
        self.on_stage("mask")
        self._looked_at = frames.stamp
        model = self._newest or self._shown(begun)
        warned = (self._light, far_depth, self._arm_sight, levelled, self._mask)
        return TwinState(
            frames.stamp,
            frames,
            model.gaussians,
            model.nodes,
            moving,
            robots,
            tuple(line for one in warned for line in one.warnings),
            levelled.exposures,
            None if is_first else model.stamp,
            tuple(map(self._mask.depth_noise_of, frames.views)),
        )

    def follow(self, seen: TwinState, left_s: LeftS = endless) -> TwinState:
        """Brings the model up to date with what `look` saw, and returns that with the model of now.

        Sets that were looked at and not followed are left out, as if they had been dropped. A set takes fewer steps
        where else its state would not be out in `left_s()`. Raises `ModelError` before the first set has been looked
        at.
        """
        begun = self._required("follow")
        self._step_budget.begin(left_s)
        warnings: tuple[str, ...] = ()
        with torch_alone():
            if seen.followed is not None:
                warnings = self._track(begun, seen)
                begun.past.remember(self._gaussians, self._nodes)
            model = self._newest = self._shown(begun)
            state = replace(
                seen, gaussians=model.gaussians, nodes=model.nodes, warnings=warnings + seen.warnings, followed=None
            )
            self._step_budget.end()
            self.on_stage("publish")
        return state

    def hear_of(self, state: TwinState) -> None:
        """What a copy of this model in another process has followed: `look` goes on with that.

        From then on sets are looked at here and followed there.
        """
        self._newest = _Shown(state.stamp, state.gaussians, state.nodes)

    def _shown(self, begun: _Begun) -> _Shown:
        cloud, nodes = cloud_of(self._gaussians, begun.motion), node_states_of(self._gaussians, self._nodes)
        return _Shown(self._nodes.stamp, cloud, nodes)

    def refine(self, proceed: Proceed = unhurried, least: int = 0) -> bool:
        """Lets be born what the last set shows, and refines what stands still; once per set, by the next `follow`
        where nobody has called it.

        A live node calls it when the state is published, so that it costs no latency. It takes some milliseconds; every
        one or two of them `proceed()` says whether there is time for more, else it goes on after the next set where it
        was; for `least` such slices there always is. Returns whether nothing was left.
        """
        if self._begun is None:
            return True
        with torch_alone():
            whole = self._begun.tracker.refine(proceed, least, self.on_stage)
        self.on_stage("refine")
        return whole

    def render(self, camera: Camera, stamp: int | None = None) -> ModelImage:
        """The model as `camera` sees it at `stamp` (ns, inside the window; None: the newest).

        Raises `ModelError` before the first set has been looked at.
        """
        begun = self._required("render")
        moment = self._moment(begun, stamp)
        with torch.no_grad():
            splats = begun.motion.place_population(moment.population, moment.poses, [moment.stamp])
        return self._shoot(splats, camera)

    def cloud(self, stamp: int | None = None) -> GaussianCloud:
        """The Gaussians that `render` draws at `stamp` (ns, inside the window; None: the newest), as they are then.

        Velocities are those of the last 10 ms, `nodes` are -1. Raises `ModelError` before the first set has been looked
        at.
        """
        begun = self._required("cloud")
        with torch_alone():
            return cloud_at(self._moment(begun, stamp), begun.motion)

    def _moment(self, begun: _Begun, stamp: int | None) -> Moment:
        return begun.past.at(self._nodes.stamp if stamp is None else stamp, self._nodes)

    def render_frozen(self, camera: Camera) -> ModelImage:
        """The model as it was fitted to the first set: the baseline that every later rendering must beat.

        Raises `ModelError` before that has been looked at.
        """
        return self._shoot(self._required("render_frozen").frozen, camera)

    def _required(self, by: str) -> _Begun:
        if self._begun is None:
            raise ModelError(f"{by}: no set has been seen yet; call update first")
        return self._begun

    def _check(self, frames: FrameSet) -> None:
        if not frames.views:
            raise ModelError(f"set {frames.sequence}: expected at least one view, found none; check the synchroniser")
        names = [view.camera.name for view in frames.views]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ModelError(
                f"set {frames.sequence}: expected one view of a camera, found {names.count(twice)} of {twice}; give "
                "every camera a name of its own"
            )
        for view in frames.views:
            if misfit := view.misfit() or wild_depth(view):
                raise ModelError(f"set {frames.sequence}: {misfit}")
        if self._begun is not None and frames.stamp < self._looked_at:
            raise ModelError(
                f"set {frames.sequence}: expected a stamp of {self._looked_at} ns or later, found {frames.stamp} ns; "
                "sort the source or start a new model"
            )

    def _exposure_of(self, view: View) -> Exposure:
        """How a camera that joins is exposed beside the model."""
        drawn = self.render(view.camera)
        return balance_joining(view, drawn.rgb, drawn.alpha)

    def _begin(self, frames: FrameSet, robots: tuple[Bool | None, ...]) -> tuple[_Begun, Levelled]:
        """The model of the first set, and the set in the light that the model has."""
        seeds = self._seeded(frames, robots)
        levelled = self._exposures.begin(frames, seeds.exposures)
        fit_all(self._gaussians, levelled.frames.views, self.parameters.seed.steps)
        begun = self._begun = self._started(frames, robots, seeds)
        self._bytes_per_frame = 4 * self.parameters_count
        return begun, levelled

    def _seeded(self, frames: FrameSet, robots: tuple[Bool | None, ...]) -> Seeds:
        """Makes the store, and spawns in it what the first set is seeded with."""
        pixels = sum(view.camera.width * view.camera.height for view in frames.views)
        capacity = min(int(pixels * self.parameters.gaussians_per_pixel), self.parameters.most_gaussians)
        self._gaussians = Gaussians(capacity, self._device)
        arms = self._arm_depths(frames, robots)
        seeds = seed(frames.views, arms, self.parameters.seed, int(SEED_SHARE * self._gaussians.capacity), self._device)
        self._gaussians.spawn(seeds.born, frames.stamp)
        return seeds

    def _started(self, frames: FrameSet, robots: tuple[Bool | None, ...], seeds: Seeds) -> _Begun:
        """What goes on from the Gaussians that have been fitted to the first set."""
        shell = shell_around([view.camera for view in frames.views], self.parameters.seed.shell_factor)
        backgrounds = Backgrounds(seeds.plane, shell)
        self._nodes.stamp = frames.stamp
        motion = Motion(self._nodes, self._make_field(shell))
        motion.slide(frames.stamp)
        tracker = Tracker(self.parameters, self._gaussians, motion, backgrounds, self._step_budget)
        self._bind_arm(tracker, frames, robots)
        self._nodes.remember()
        past = Past(self._gaussians, self.parameters.nodes, self.parameters.window)
        past.remember(self._gaussians, self._nodes)
        rows = torch.nonzero(self._gaussians.alive)[:, 0]
        with torch.no_grad():
            frozen = motion.place(self._gaussians, rows, motion.poses([0.0]), [frames.stamp])
        return _Begun(motion, tracker, past, frozen)

    def _make_field(self, shell: Shell) -> HexPlane:
        """The field spans what the cameras stand around; beyond, it is clamped."""
        reach = shell.radius / self.parameters.seed.shell_factor
        centre = torch.from_numpy(shell.centre).to(self._device)
        return HexPlane(centre - reach, centre + reach, self.parameters.window, seed=self._seed)

    def _arm_depths(self, frames: FrameSet, robots: tuple[Bool | None, ...]) -> list[Float32 | None]:
        if self._arm is None or frames.joints is None:
            return [None] * len(frames.views)
        at = [self._arm.ordered_positions(frames.joints.at(view.stamp)) for view in frames.views]
        return [
            None if mask is None else arm_depth(self._arm, q, view.camera, mask)
            for q, view, mask in zip(at, frames.views, robots, strict=True)
        ]

    def _bind_arm(self, tracker: Tracker, frames: FrameSet, robots: tuple[Bool | None, ...]) -> None:
        """What lies on the arm goes with it from the first set on that tells of its joints and finds nodes for it."""
        if tracker.has_arm or self._arm is None or frames.joints is None or self._nodes.free < len(links_of(self._arm)):
            return
        joints, masks = frames.joints.at(frames.stamp), [mask for mask in robots if mask is not None]
        links = RobotLinks(self._arm, self._nodes, joints)
        links.bind(self._gaussians, joints, masks, [view.camera for view in frames.views])
        tracker.follow_arm(links)

    def _track(self, begun: _Begun, seen: TwinState) -> tuple[str, ...]:
        """Follows what was seen; what went wrong with it."""
        frames, robots = seen.frames, seen.robot_masks
        self._bind_arm(begun.tracker, frames, robots)
        refused_before = self._gaussians.refused
        dt_s = (frames.stamp - self._nodes.stamp) * 1e-9
        tracked = begun.tracker.track(frames, seen.moving_masks, robots, dt_s, self.on_stage)
        self.decisions = tracked.decisions
        moved = len(self._gaussians.moving_rows)
        self._bytes_per_frame = 4 * (14 * (tracked.born + moved) + 7 * len(self._nodes.rows))
        warnings = []
        refused = self._gaussians.refused - refused_before
        if refused:
            warnings.append(f"model: {refused} steps of Gaussians were not finite; the last good values were kept")
        if tracked.braked is not None:
            rate = tracked.braked * self.parameters.track.learning_rate
            warnings.append(f"model: steps made the images worse and were undone; learning on at a rate of {rate:.2g}")
        return tuple(warnings)

    def _shoot(self, splats: Splats, camera: Camera) -> ModelImage:
        with torch.no_grad():
            seen = render(splats, [camera])[0]
        return ModelImage(seen.rgb.clamp(0, 1).cpu().numpy(), seen.depth.cpu().numpy(), seen.alpha.cpu().numpy())
