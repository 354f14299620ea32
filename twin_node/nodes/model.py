"""The model node: frame sets in, what they show, the state of the twin and its Gaussian clouds out."""

from __future__ import annotations

import gc
from collections.abc import Callable
from enum import Enum

import numpy as np

from twin_node.messages import convert
from twin_node.model import WindowModel
from twin_node.model.first_light import FirstLight
from twin_node.model.model_process import ModelProcess
from twin_node.model.stages import LeftS, Proceed, endless, unhurried
from twin_node.nodes.cloud_updates import CloudUpdates
from twin_node.nodes.sizing import Trial
from twin_node.nodes.topics import GAUSSIANS, GAUSSIANS_CHANGED, GAUSSIANS_MOVING, SEEN, STATE, TRUSTED_FRAMES
from twin_node.runtime.bus import Bus
from twin_node.runtime.clock import Clock
from twin_node.runtime.image_threads import image_loops_alone
from twin_node.runtime.node import Node
from twin_node.runtime.worker_process import is_worth_it
from twin_node.scene import FrameSet, Tier, TwinState
from twin_node.scene.narrowing import Narrower

WHOLE_CLOUD_PERIOD_NS = 1_000_000_000
"""The whole cloud goes out latched at 1 Hz; what has changed since, and what moves, with every set that the model
follows."""
MOST_LET_BE = 1
"""So many sets in a row, at most, are looked at and not followed when the next one waits already: following takes as
long as everything else, and without it the arm hears of people that much more often."""
LAST_S = 3.0
"""How long what is followed at the end is waited for, s: less than a launcher waits before it kills a process."""


class Following(Enum):
    """When and where the model follows the sets that it has looked at."""

    IN_TURN = "in turn"
    """Each before the next, however long it takes: lockstep."""
    IN_TIME = "in time"
    """While the clock runs: a set can be late, and is let be where the next one waits."""
    APART = "apart"
    """The same in a process of its own, where there is a processor for it."""


class ModelNode(Node):
    """Keeps a `WindowModel` up to date with the newest frame set.

    What a set shows goes out before the model has followed it, for that takes twice as long: the arm waits for no more
    than the forecast of it. `work_between_sets` does that afterwards, and what can wait; `Following.APART` another
    process does both, as soon as it has loaded, and the model here only looks.
    """

    def __init__(
        self,
        bus: Bus,
        clock: Clock,
        model: WindowModel,
        following: Following = Following.IN_TURN,
        trial: Trial | None = None,
        is_too_slow: Callable[[], bool] = lambda: False,
        on_anew: Callable[[int], None] = lambda stamp: None,
    ) -> None:
        """With a `trial`, sets are measured on until it is over, and the model it found takes the place of `model`.

        From then on a smaller one, that begins anew, does so whenever this twin `is_too_slow()`. Before anything of it
        is published `on_anew(stamp)` tells from which set's stamp (ns) on states are its.
        """
        super().__init__("model", bus, clock)
        self.model = model
        self._is_live = following is not Following.IN_TURN
        self._is_apart = following is Following.APART and is_worth_it()
        self._process: ModelProcess | None = None
        self._trial, self._sizes = trial, trial
        self._is_too_slow, self._on_anew = is_too_slow, on_anew
        self._is_told_of_arm = False
        self._may_begin_anew = False
        """Whether a model that begins now would take for ground no more than this one does."""
        self._narrower: Narrower | None = None
        self._light = FirstLight()
        self._is_dark = True
        """Whether no camera has shown anything so far: such sets are let be, for the first is the scene at rest."""
        self._seen: TwinState | None = None
        """What has been looked at and waits to be followed."""
        self.followed = 0
        """Sets that the model has followed."""
        self._followed: TwinState | None = None
        """What another process has followed, until it is published: that can wait for the arm."""
        self._let_be = 0
        """Sets in a row that were looked at and not followed."""
        self._next_whole = 0
        self._clouds = CloudUpdates()
        self._is_first = True
        """Whether the model has followed no set yet."""

    @property
    def parameters_count(self) -> int:
        """Numbers that describe the scene now, see `WindowModel.parameters_count`."""
        process = self._process
        return self.model.parameters_count if process is None or not process.has_model else process.parameters_count

    @property
    def peak_rss_mb_elsewhere(self) -> float:
        """Most memory that a process of its own has held, MB; 0 without."""
        return 0.0 if self._process is None else self._process.peak_rss_mb

    def on_configure(self) -> None:
        image_loops_alone()
        if self._trial is None:  # else it would be timed beside what loads
            self._begin_process()
        self.bus.subscribe(TRUSTED_FRAMES, self._on_frames)

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        """Whether it waits for the cameras to show something."""
        if not self._light.warnings or not self._is_dark:
            return ()
        message = "waits: all cameras have shown nothing so far, black or burnt out; mend the light"
        return (convert.Diagnosis(f"{self.name}: light", convert.Level.WARN, message),)

    def on_deactivate(self) -> None:
        """What is followed now still goes out."""
        self._collect(LAST_S)
        self._publish_followed()

    def on_cleanup(self) -> None:
        if self._process is not None:
            self._process.close()
        if not self._is_first:
            gc.unfreeze()  # nobody would ever look for what goes with this node

    def _on_frames(self, frames: FrameSet) -> None:
        hides_arm = self._is_told_of_arm and frames.joints is None  # it would be ground, which moves on
        self._is_told_of_arm = self._is_told_of_arm or frames.joints is not None
        if self._sizes is not None and self._may_begin_anew and not hides_arm and self._is_too_slow():
            self._shrink(self._sizes, frames.stamp)
        self._is_dark = self._is_dark and self._light.is_dark(frames)
        if self._is_dark:
            return
        if self._trial is not None:
            self._try(self._trial, frames)
            return
        if self._narrower is not None:
            frames = self._narrower.narrowed(frames)
        if not self._is_live:
            self.follow()
        self._collect()
        self._seen = self.model.look(frames)
        self.bus.publish(SEEN, self._seen)  # on a bus within the process this is when the forecast is made
        self._may_begin_anew = _is_at_rest(self._seen)

    def follow(self) -> None:
        """Brings the model up to date with what the newest set has shown, and publishes it; called once all that comes
        of that before is delivered. Where nobody calls it the next set does, unless live. Nothing where no set waits.
        """
        seen, self._seen = self._seen, None
        if seen is None:
            return
        self._publish(self.model.follow(seen, self._left_s(seen.frames)))

    def _publish(self, state: TwinState) -> None:
        """Sends out what the model has followed."""
        self.followed += 1
        cloud = state.gaussians
        changed, moving = self._clouds.changed(cloud), cloud.only(cloud.tiers != Tier.STATIC)
        self.bus.publish(GAUSSIANS_CHANGED, convert.gaussians_to_pointcloud2(changed, state.stamp))
        self.bus.publish(GAUSSIANS_MOVING, convert.gaussians_to_pointcloud2(moving, state.stamp))
        self.bus.publish(STATE, state)
        if self._is_first:
            self._is_first = False
            gc.collect()
            gc.freeze()  # what is there now lives as long as this node: to go through it again costs tens of ms
        if state.stamp >= self._next_whole:
            self._next_whole = state.stamp + WHOLE_CLOUD_PERIOD_NS
            self._clouds.whole(cloud)
            self.bus.publish(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud, state.stamp))

    def _left_s(self, frames: FrameSet) -> LeftS:
        """Says how long a set has until it is older than wished for."""
        latency_ms = self.model.parameters.track.latency_ms
        if not self._is_live or not latency_ms:
            return endless
        due = frames.stamp + round(latency_ms * 1e6)
        return lambda: (due - self.clock.now()) * 1e-9

    def _try(self, trial: Trial, frames: FrameSet) -> None:
        sized = trial.take(frames)
        if sized is not None:
            self._trial, self._narrower, self.model = None, sized.narrower, sized.model
            self._begin_process()

    def _shrink(self, sizes: Trial, stamp: int) -> None:
        """Goes on from a set's stamp (ns) on with the next smaller size, which has everything to learn; with the
        smallest as it is."""
        sized = sizes.smaller()
        if sized is None:
            self._sizes = None
            return
        if self._process is not None:
            self._process.let_go()
        gc.unfreeze()
        self.model, self._narrower = sized.model, sized.narrower
        self._seen, self._followed, self._let_be = None, None, 0
        self._is_first, self._is_dark, self._light = True, True, FirstLight()
        self._clouds, self._next_whole = CloudUpdates(), 0
        self._on_anew(stamp)

    def _begin_process(self) -> None:
        if self._is_apart:
            self._process = ModelProcess()

    def work_between_sets(self, proceed: Proceed = unhurried) -> None:
        """Follows the newest set where that has not been done, and uses the time until the next for what it shows anew
        and to refine what stands still.

        Called by whoever runs the node once everything that came of a set is delivered; where nobody calls it this is
        done when the next one comes. `proceed()` says whether no other set waits, see `WindowModel.refine`: of sets
        that come faster every other one is let be. In lockstep none waits, so every set gets its share.
        """
        if self._process is not None and self._process.has_model:
            self._hand_over(self._process)
            return
        if self._seen is not None and self._let_be < MOST_LET_BE and not proceed():
            self._let_be, self._seen = self._let_be + 1, None
            return
        self._let_be = 0
        self.follow()
        self.model.refine(proceed)
        if self._process is not None and not self._is_first and self._process.is_loaded():
            self._process.take(self.model)

    def await_process(self) -> None:
        """Waits until the process of its own follows the sets that come from now on, where there is to be one; called
        after the first set by who does not want that to happen while later ones come."""
        if self._process is not None and not self._is_first and self._process.is_loaded(wait=True):
            self._process.take(self.model)

    def _hand_over(self, process: ModelProcess) -> None:
        """Publishes what the other process has followed, and lets it follow the newest set where it is free."""
        self._collect()
        self._publish_followed()
        seen = self._seen
        if seen is not None and process.is_free:
            self._seen = None
            process.follow(seen)

    def _collect(self, wait_s: float = 0.0) -> None:
        """Takes in what the other process has followed, if it has within `wait_s` seconds."""
        process = self._process
        state = None if process is None or not process.has_model else process.result(wait_s)
        if state is not None:
            self.model.hear_of(state)
            self._followed = state

    def _publish_followed(self) -> None:
        state, self._followed = self._followed, None
        if state is not None:
            self._publish(state)


def _is_at_rest(seen: TwinState) -> bool:
    """Whether nothing moves, as far as that counts: where all is measured, who has been taken for ground is in the way
    all the same."""
    return all(view.depth is not None for view in seen.frames.views) or not any(map(np.any, seen.moving_masks))
