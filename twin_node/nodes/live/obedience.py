"""Whether an arm that is told to stand does so: a controller may take its speed from elsewhere, and say nothing."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

STOPS_S = 1.0
"""An arm that has been told to stand for so long does, s."""
MOVES_RAD_S = 0.05
"""What stands is told to be slower, rad/s: encoders and their filters tell some mrad/s of an arm at rest."""
LASTS_S = 0.3
"""For so long it has to move, s: one sample may be wrong."""


class _Moving(NamedTuple):
    """A joint that moves though it is to stand."""

    since: float
    rad_s: float


class Obedience:
    """Follows what an arm is told and how it moves; times in s, of one clock."""

    def __init__(self, joint_names: Collection[str]) -> None:
        self._joint_names = frozenset(joint_names)
        self._stands_from = math.inf
        """From when on it is to stand."""
        self._moving: dict[str, _Moving] = {}
        """Joints that move though they are to stand."""
        self._heard = -math.inf
        """When it was last told how fast any joint is."""

    def tell(self, share: float, now: float) -> None:
        """The arm is told its share of speed."""
        if share > 0.0:
            self._stands_from = math.inf
            self._moving.clear()
        elif math.isinf(self._stands_from):
            self._stands_from = now + STOPS_S

    def hear(self, speeds: Mapping[str, float], now: float) -> None:
        """Joints are told to be so fast, rad/s, without sign."""
        for name in self._joint_names & speeds.keys():
            self._heard = now
            before = self._moving.pop(name, None)
            if speeds[name] > MOVES_RAD_S and now >= self._stands_from:
                self._moving[name] = _Moving(now if before is None else before.since, speeds[name])

    def fault(self, now: float) -> str | None:
        """What is to be told of an arm that does not obey; None: it does, for all that is known."""
        first = min((one.since for one in self._moving.values()), default=math.inf)
        if now - first < LASTS_S or now - self._heard > STOPS_S:
            return None
        fastest = max(one.rad_s for one in self._moving.values())
        return (
            f"the arm moves, by {fastest:.2f} rad/s, though its controller has been told to stand: that commands "
            "velocities, takes its speed from elsewhere, or something else moves the arm"
        )
