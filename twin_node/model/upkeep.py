"""What can wait until a set's state is out: what stands is learnt and drawn anew, and the arm learns its look."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

from twin_node.model.arm_skin import ArmSkin
from twin_node.model.backgrounds import Backgrounds
from twin_node.model.gaussians import Gaussians
from twin_node.model.mapping import Mapper
from twin_node.model.observation import Observed
from twin_node.model.parameters import ModelParameters
from twin_node.model.stages import Proceed, Sliced
from twin_node.scene import Bool, JointSample


@dataclass(frozen=True)
class Seen:
    """What a set has shown."""

    observed: Sequence[Observed]
    joints: JointSample | None
    """How the arm stood."""
    robots: Sequence[Bool | None]
    """[H, W] the arm's masks."""
    stamp: int
    """ns."""


class Upkeep:
    """Work that can be let be after any slice of it and gone on with after a later set."""

    def __init__(self, parameters: ModelParameters, gaussians: Gaussians, backgrounds: Backgrounds) -> None:
        self._steps = parameters.map.steps
        self._gaussians = gaussians
        self._backgrounds = backgrounds
        self.skin: ArmSkin | None = None
        """That of the arm, once it is known where that is."""
        most_static = max(int((1 - parameters.birth.moving_share) * gaussians.capacity), len(gaussians))
        self._mapper = Mapper(parameters.map, gaussians, backgrounds, most_static)
        self._learning: Sliced | None = None
        """What has begun to be learnt of a set and was not left the time to end."""
        self._is_behind = False
        """Whether what stands still has not been drawn anew when it was due."""

    def begin(self, seen: Seen, steps: int) -> None:
        """Begins to learn `steps` at most from a set, where nothing else has been begun.

        Another thread looks at what stands while this one does other things, from each slice of `learn` to the next.
        """
        if self._learning is None and self._tells_of_what_stands(seen) and not self._backgrounds.are_outdated:
            self._learning = Sliced(self._slices(seen, min(steps, self._steps)))
            self.learn(lambda: self._learning is not None and not self._learning.has_begun)

    def go_on(self, proceed: Proceed) -> bool:
        """Does what there is time for; learning and drawing take turns. Returns whether nothing is left."""
        drawn = (self._is_behind or self._backgrounds.are_outdated) and self.draw(proceed)
        learnt = self.learn(proceed)
        drawn = drawn or self.draw(proceed)
        self._is_behind = not drawn
        return learnt and drawn

    def learn(self, proceed: Proceed) -> bool:
        """Goes on with what has been begun to be learnt; whether it came to its end."""
        learnt = self._learning is None or self._learning.go_on(proceed)
        if learnt:
            self._learning = None
        return learnt

    def draw(self, proceed: Proceed) -> bool:
        """What stands still is drawn anew, for the next set; whether all that is due of it."""
        return not self._backgrounds.are_behind or Sliced(self._backgrounds.keep_up(self._gaussians)).go_on(proceed)

    def _slices(self, seen: Seen, steps: int) -> Generator[None]:
        """A set's share of what can be let be; the arm's while the second look is taken."""
        if not steps:
            return
        learning = self._mapper.refine(seen.observed, seen.stamp, steps)
        skinning: Generator[None] | None = None
        if self.skin is not None and seen.joints is not None:
            skinning = self.skin.refine(seen.observed, seen.joints, seen.robots)
        for _ in range(2):
            next(learning, None)
            yield
        if skinning is not None:
            yield from skinning
            yield
        yield from learning

    def _tells_of_what_stands(self, seen: Seen) -> bool:
        """Whether a set was observed before the background that there is now: before another it teaches nothing."""
        return all(self._backgrounds.is_current(one.background) for one in seen.observed)
