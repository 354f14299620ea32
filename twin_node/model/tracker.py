"""One set after another: node motion and the Gaussians that move; STATIC ones are left alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.model.aligning import Aligner
from twin_node.model.arm_skin import ArmSkin
from twin_node.model.backgrounds import Backgrounds
from twin_node.model.bodies import Bodies
from twin_node.model.chosen import rows_where
from twin_node.model.decisions import Decision
from twin_node.model.fitting import Fitted, fit_moving
from twin_node.model.gaussians import Gaussians
from twin_node.model.held import held_pixels
from twin_node.model.motion import Motion
from twin_node.model.observation import Observed, Observer
from twin_node.model.occluders import occluders
from twin_node.model.parameters import ModelParameters
from twin_node.model.placing import Placer
from twin_node.model.population import Population
from twin_node.model.regrouping import Carried
from twin_node.model.rendering import Rendering, Splats
from twin_node.model.resting import Resting
from twin_node.model.robot_links import RobotLinks
from twin_node.model.slack import Slack
from twin_node.model.stages import OnStage, Proceed, granted, unhurried, unwatched
from twin_node.model.step_budget import Part, StepBudget
from twin_node.model.unselected import fit_unselected
from twin_node.model.upkeep import Seen, Upkeep
from twin_node.model.usual_pace import usual_periods
from twin_node.scene import Bool, FrameSet

LEAST_SLICES = 4
"""Slices of what can be let be that are done for a set where time stays short: a step of what stands, or drawing it."""
BRAKE, PICK_UP = 0.1, 1.1
"""What the learning rate is multiplied by after steps that diverged, and after others until it is whole again."""

MOST_STRETCHED = 4.0
"""How many times `track.steps` a set has at most, where it comes so many usual periods after the set before."""


@dataclass(frozen=True)
class Tracked:
    """What a set has led to."""

    born: int
    """Gaussians."""
    braked: float | None
    """Share of the learning rate that is left after steps that diverged and were undone; None: they did not."""
    decisions: Sequence[Decision]
    """Nodes that have merged, split and come to rest since the set before was tracked, or woken now, and why."""


@dataclass(frozen=True)
class _Aligned:
    """What the views saw of the prediction, and the rows that can stand before what moves."""

    renderings: list[Rendering]
    before: Tensor
    around: Splats
    """These and the arm, at each view's time."""
    carried: Carried | None
    """The Gaussians that nodes carry; None where no flow was sought."""


@dataclass(frozen=True)
class _Due:
    """A set that has been tracked, and what the views saw of the model then."""

    seen: Seen
    carried: Carried | None
    """The Gaussians that nodes carried; None where no flow was sought."""
    renderings: list[Rendering]
    around: Splats
    """What stood before what moves, and the arm, at each view's time."""


class Tracker:
    """Keeps Gaussians and nodes up to date with the newest images; a set is `track`."""

    def __init__(
        self,
        parameters: ModelParameters,
        gaussians: Gaussians,
        motion: Motion,
        backgrounds: Backgrounds,
        step_budget: StepBudget,
    ) -> None:
        self._parameters = parameters
        self._step_budget = step_budget
        self._gaussians = gaussians
        self._motion = motion
        self._nodes = motion.nodes
        self._backgrounds = backgrounds
        self._observer = Observer(parameters.birth.stale_s)
        self._links: RobotLinks | None = None
        self._upkeep = Upkeep(parameters, gaussians, backgrounds)
        self._bodies = Bodies(gaussians, motion.nodes)
        self._resting = Resting(gaussians, motion.nodes, backgrounds)
        self._placer = Placer(gaussians, motion)
        self._population = Population(parameters, gaussians, motion, backgrounds, self._placer, self._resting)
        self._aligner = Aligner(parameters.track, gaussians, motion.nodes, self._placer, self._bodies)
        self._decisions: list[Decision] = []
        self._pace = 1.0
        self._born = 0
        self._due: _Due | None = None
        """A set that has been tracked and that nothing else has been made of yet."""
        self._slack = Slack()

    @property
    def has_arm(self) -> bool:
        """Whether it follows an arm."""
        return self._links is not None

    def follow_arm(self, links: RobotLinks) -> None:
        """From the next set on the arm is where the joints say; what is bound to `links` stands no longer."""
        self._links = links
        self._upkeep.skin = ArmSkin(links, self._gaussians, self._motion)
        self._backgrounds.renew()

    def track(
        self,
        frames: FrameSet,
        moving: Sequence[Bool],
        robots: Sequence[Bool | None],
        dt_s: float,
        on_stage: OnStage = unwatched,
    ) -> Tracked:
        """Follows `frames`, taken `dt_s` after the set before."""
        self.refine(on_stage=on_stage)
        born, self._born = self._born, 0
        cameras, waits = [view.camera for view in frames.views], not self._step_budget.may_be_late
        backgrounds = self._backgrounds.of(self._gaussians, cameras, waits)
        observed = self._observer.observe(frames, moving, robots, backgrounds, dt_s)
        on_stage("observe")
        self._nodes.predict(frames.stamp, self._parameters.track.velocity_damping)
        self._motion.slide(frames.stamp)
        if self._links is not None:
            joints = None if frames.joints is None else frames.joints.at(frames.stamp)
            self._links.drive(joints, dt_s)
        self._step_budget.plan(Part.FIT, self._planned(dt_s))
        aligned = self._align(observed, dt_s)
        self._decisions += self._aligner.take_decisions()
        on_stage("align")
        self._decisions += self._resting.wake(observed, aligned.renderings)
        arm_lost_s = 0.0 if self._links is None else self._links.unknown_s
        self._population.judge(observed, aligned.renderings, arm_lost_s)
        around = self._around(observed, aligned)
        self._aligner.catch_up(observed, around, dt_s, self._step_budget)
        on_stage("judge")
        fitted = self._fit(observed, around)
        on_stage("fit")
        self._nodes.remember()
        seen = Seen(observed, frames.joints, robots, self._nodes.stamp)
        self._due = _Due(seen, aligned.carried, fitted.renderings or aligned.renderings, around)
        decisions, self._decisions = self._decisions, []
        return Tracked(born, self._pace if fitted.diverged else None, decisions)

    def refine(self, proceed: Proceed = unhurried, least: int = 0, on_stage: OnStage = unwatched) -> bool:
        """What is left to do of the last set, where it has not been done yet; whether nothing is left to do.

        Births are guesses until the next set has fitted them, so that the state that is published before them looks
        better without; who merges and splits shows in what comes. Where `proceed` leaves no time all is put off, but
        not twice in a row. Whoever never finds a set waiting, and yet has no time, has `least` slices of what can wait
        done all the same.
        """
        due, self._due = self._due, None
        if due is None:
            return True
        self._slack.begin(proceed)
        if self._slack.put_off > 1:
            return self._do_what_presses(due, least, on_stage)
        if not self._slack.put_off:
            self._do_all(due, on_stage)
        is_done = self._upkeep.go_on(granted(least, proceed))
        return is_done and not self._slack.put_off

    def _do_all(self, due: _Due, on_stage: OnStage) -> None:
        """All that a set leaves to do but what can wait; once another set has come, as none did lately, no more of it.

        Another thread looks at what the set's steps miss while this one regroups and prunes, and while it bears. Where
        sets have waited of late one step is all: a second takes a tenth of a set's processor time, of both threads.
        """
        self._upkeep.begin(due.seen, self._parameters.map.steps if self._slack.is_at_ease else 1)
        on_stage("begin")
        if not self._slack.lasts():
            return
        self._regroup(due)
        on_stage("regroup")
        if not self._slack.lasts():
            return
        self._population.prune(due.seen.observed, due.around)
        self._upkeep.learn(granted(1))
        if not self._slack.lasts():
            return
        self._bear(due)
        on_stage("bear")

    def _do_what_presses(self, due: _Due, least: int, on_stage: OnStage) -> bool:
        """What was put off after the set before: nothing is pruned, and what stands takes a step after one set and is
        drawn anew after the next. Returns whether nothing of that is left."""
        learns = self._slack.put_off % 2 == 0
        if learns:
            self._upkeep.begin(due.seen, 1)
            on_stage("begin")
        self._regroup(due)
        on_stage("regroup")
        self._bear(due)
        on_stage("bear")
        keep_up = self._upkeep.learn if learns and not self._backgrounds.are_outdated else self._upkeep.draw
        return keep_up(granted(max(LEAST_SLICES, least)))

    def _regroup(self, due: _Due) -> None:
        self._decisions += self._bodies.regroup(due.carried)
        if self._bodies.decided_s:
            self._decisions += self._resting.settle(self._bodies.resting, self._bodies.decided_s)

    def _bear(self, due: _Due) -> None:
        born = self._population.bear(due.seen.observed, due.renderings)
        self._born = born.gaussians
        self._decisions += born.woken

    def end(self) -> None:
        """Ends what `refine` has begun and not been left the time for."""
        self._upkeep.learn(unhurried)

    def _align(self, observed: Sequence[Observed], dt_s: float) -> _Aligned:
        """Node poses from the flow between the predicted rendering and the images."""
        poses = self._placer.poses(observed)
        rows = self._gaussians.moving_rows
        splats = self._placer.place(rows, observed, poses)
        before = self._before(observed, splats)
        around = self._placer.place(torch.cat([before, self._gaussians.robot_rows]), observed, poses)
        renderings = self._placer.look(observed, splats, around)
        renderings, told_of = self._aligner.follow(observed, rows, splats, around, renderings, dt_s)
        return _Aligned(renderings, before, around, told_of)

    def _around(self, observed: Sequence[Observed], aligned: _Aligned) -> Splats:
        """What stands before what moves and has not been judged otherwise since, and the arm."""
        standing = self._standing(aligned.before)
        if len(standing) == len(aligned.before):
            return aligned.around
        return self._placer.place(
            torch.cat([standing, self._gaussians.robot_rows]), observed, self._placer.poses(observed)
        )

    def _fit(self, observed: Sequence[Observed], around: Splats) -> Fitted:
        """Canonical attributes of what moves by a few gradient steps; after some that diverged the next are smaller."""
        g, track = self._gaussians, self._parameters.track
        poses, rate = self._placer.poses(observed), self._pace * track.learning_rate
        if track.selects:
            masks = held_pixels(observed, self._placer.place(g.moving_rows, observed, poses))
            steps = self._step_budget.steps(Part.FIT)
            fitted = fit_moving(g, self._motion, observed, poses, masks, around, steps, rate)
            self._step_budget.done(Part.FIT, steps)
        else:
            self._backgrounds.mark()
            fitted = fit_unselected(g, self._motion, observed, poses, track.steps, rate)
        self._pace = self._pace * BRAKE if fitted.diverged else min(1.0, self._pace * PICK_UP)
        return fitted

    def _planned(self, dt_s: float) -> int:
        """Steps of the fit, which grow with what has changed, where there is time for them: while sets wait, more would
        only make them rarer."""
        stretch = min(usual_periods(dt_s), MOST_STRETCHED) if self._slack.is_at_ease else 1.0
        return int(self._parameters.track.steps * stretch)

    def _before(self, observed: Sequence[Observed], moving: Splats) -> Tensor:
        """STATIC rows that can stand before what moves."""
        before = occluders([one.background for one in observed], moving.means.cpu().numpy())
        rows = self._backgrounds.rows
        return self._standing(rows.index_select(0, torch.from_numpy(before.nonzero()[0]).to(rows.device)))

    def _standing(self, rows: Tensor) -> Tensor:
        """Those of the background's `rows` [n] that still stand."""
        return rows.index_select(0, rows_where(self._backgrounds.stand(self._gaussians, rows)))
