"""Fewer steps for a set whose state would else be out late: latency's worst case for a little of its quality."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping
from enum import Enum

from twin_node.model.stages import LeftS, endless

SPARED = 0.1
"""Sets that may be hurried for each that was in time. One that was late all the same costs as much as one that was
hurried: where many are, no few steps bring them in time, and fewer steps cost what they show.
"""
IN_A_ROW = 4
"""Sets that may be hurried one after another after a time of ease."""
KEPT = 9
"""Durations that tell what a part's next step may take: the longest but one, which no single pause changes."""


class Part(Enum):
    """What a set has more or fewer steps of, in the order in which it is done."""

    CATCH_UP = "catch up"
    FIT = "fit"


PARTS = tuple(Part)


class StepBudget:
    """Counts out each set's steps by the time that is left for it and what steps have taken lately."""

    def __init__(self, steps: Mapping[Part, int]) -> None:
        """`steps`: those of a set that has time for all."""
        self._steps = dict(steps)
        self._left_s: LeftS = endless
        self._durations = {part: deque[float](maxlen=KEPT) for part in Part}
        self._endings: deque[float] = deque(maxlen=KEPT)
        """From the last part's end until the state was out, s."""
        self._since_s = math.inf
        """What was left when the last part began or ended, s."""
        self._credit = float(IN_A_ROW)
        self._is_hurried = False
        self.hurried = 0
        """Sets that have had fewer steps."""

    def plan(self, part: Part, steps: int) -> None:
        """From now on a set that has time for all has so many steps of a part."""
        self._steps[part] = steps

    def begin(self, left_s: LeftS) -> None:
        """A set begins whose state should be out in `left_s()`."""
        self._left_s, self._since_s, self._is_hurried = left_s, math.inf, False

    @property
    def may_be_late(self) -> bool:
        """Whether anybody waits for this set's state."""
        return math.isfinite(self._left_s())

    def steps(self, part: Part) -> int:
        """How many steps there is time for of a part that now begins: one or more, of those planned.

        A set that is late already by more than what it takes with one step of each part is past saving.
        """
        planned, left = self._steps[part], self._left_s()
        self._since_s = left
        least, step = self._takes(part, 1), self._step(part)
        if self._takes(part) <= left or left < -least or not step or not self._may_hurry():
            return planned
        return min(1 + max(int((left - least) / step), 0), planned)

    def done(self, part: Part, steps: int) -> None:
        """The part that has begun has ended after so many steps."""
        taken = self._lap()
        if steps and math.isfinite(taken):
            self._durations[part].append(taken / steps)

    def end(self) -> None:
        """The set's state is out."""
        taken = self._lap()
        if math.isfinite(taken):
            self._endings.append(taken)
        if self._since_s >= 0:
            self._credit = min(self._credit + SPARED, IN_A_ROW)
        elif not self._is_hurried:
            self._credit = max(self._credit - 1, 0.0)
        self._left_s = endless

    def _lap(self) -> float:
        before, self._since_s = self._since_s, self._left_s()
        return before - self._since_s if math.isfinite(before) else math.inf

    def _may_hurry(self) -> bool:
        if not self._is_hurried and self._credit >= 1:
            self._credit -= 1
            self._is_hurried = True
            self.hurried += 1
        return self._is_hurried

    def _takes(self, begun: Part, most: int | None = None) -> float:
        """From the beginning of a part until the state is out, s, with `most` steps of each part or with all."""
        total = _expected(self._endings)
        for part in PARTS[PARTS.index(begun) :]:
            planned = self._steps[part]
            total += self._step(part) * (planned if most is None else min(planned, most))
        return total

    def _step(self, part: Part) -> float:
        """What a step of a part takes, s; 0 before any was timed."""
        return _expected(self._durations[part])


def _expected(durations: Collection[float]) -> float:
    """What the next of such durations (s) should not be above; 0 before there were two."""
    return sorted(durations)[-2] if len(durations) > 1 else 0.0
