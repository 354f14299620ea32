"""How fast an arm's program would move it at full speed, seen through the share that it is held to."""

from __future__ import annotations

import numpy as np

from twin_node.scene import Float64

_SLOWEST = 0.05
"""Share of the speed below which an arm that lags behind what it was told seems to have a program of no speed."""
_BRAKING_NS = 200_000_000
"""After the share has fallen the arm is faster than it for about so long, ns: what was known before still holds. For no
longer: the law gives another share with every decision, and a program turns meanwhile."""
_STOPPED_NS = 1_500_000_000
"""After so long, ns, the slowest arm of the stopping tables stands: one that moves obeys nobody, or is led by hand."""
_STANDS = 0.05
"""rad/s: noise of joints that stand, ten times over."""
_BEGINS = 0.02
"""rad/s: noise, four times over: an arm of which nothing is known has begun to move."""


class ProgrammedVelocity:
    """Takes the share out of velocities, and remembers the program's own while the arm stands.

    The separation law asks how fast the program would move the arm, not how fast it moves while it is held back: an
    arm that was stopped for somebody still means to go on.
    """

    def __init__(self, least_share: float, ratings: Float64) -> None:
        """`least_share`: below it velocities tell nothing of the program.

        `ratings` [J] (rad/s): no program is faster, unless the arm itself was measured to be.
        """
        self._least_share = least_share
        self._ratings = ratings
        self._known: Float64 | None = None
        self._share = 0.0
        self._fell = 0
        self._learnt = 0
        self._seen = 0

    @property
    def is_known(self) -> bool:
        """Whether anything is known of the program."""
        return self._known is not None

    def forget(self) -> None:
        """The program has ended."""
        self._known = None

    def seen(self, velocities: Float64, share: float, stamp: int) -> Float64:
        """The program's velocities [J] (rad/s), by those of an arm that is held to a share (0 to 1), at a time (ns).

        As they are where nothing is known of the program yet.
        """
        if stamp < self._seen:  # the clock was put back: when the arm braked, and when not, nobody can tell by it
            self._fell = self._learnt = stamp - _BRAKING_NS
        if share < self._share:
            self._fell = stamp
        self._share, self._seen = share, stamp
        is_braking = self._known is not None and stamp - min(self._fell, self._learnt) < _BRAKING_NS
        begins = self._known is None and share > 0 and np.abs(velocities).max() > _BEGINS
        if begins or (share > self._least_share and not is_braking):
            fastest = np.maximum(self._ratings, np.abs(velocities))
            self._learn(np.clip(velocities / share, -fastest, fastest), share, stamp)
        elif stamp - self._fell > _STOPPED_NS and np.abs(velocities).max() > _STANDS:
            self._known, self._learnt = velocities, stamp
        return self.recalled(velocities)

    def recalled(self, velocities: Float64) -> Float64:
        """The program's velocities [J] (rad/s) as they were seen last; those of the arm where nothing is known."""
        return velocities if self._known is None else self._known

    def _learn(self, found: Float64, share: float, stamp: int) -> None:
        """Take the program's velocities as found at a share, unless the arm may only lag behind it."""
        known = self._known
        if known is None or share > _SLOWEST or np.abs(found).max() >= np.abs(known).max() / 2:
            self._known, self._learnt = found, stamp
