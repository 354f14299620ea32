"""What moved a while ago and stands now: people who keep still look like furniture, and may start again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import Bits
from twin_node.scene import Grid

RESTING_S = 20.0
"""How long what has moved by itself may start again, s: one start spoils the forecasts of one horizon of 0.2 s, and a
target of 99 % allows one in a hundred. Longer rests are those of things that somebody put down."""
_NEVER = np.iinfo(np.int64).min // 2


class Resting:
    """Follows which standing voxels of one grid moved of late, state by state."""

    def __init__(self, grid: Grid) -> None:
        self._moved_at = np.full(grid.size, _NEVER, np.int64)
        self._moved = Bits.none(grid.dims)
        """Where something moved that has not been found to have been too long ago."""

    def update(self, stamp: int, moving: NDArray[np.int64], standing: Bits) -> NDArray[np.int64]:
        """Flat indices [n] of voxels that stand at `stamp` (ns, rising), and did not when something moved in them.

        `moving` [m]: flat indices where something moves that may rest and start again; `standing`: what stands. A table
        that a hand passes over stood all along: it is none of these.
        """
        started = moving[~standing.holds(moving)]
        self._moved_at[started] = stamp
        self._moved.add(started)
        stands = (self._moved & standing).indices()
        is_recent = self._moved_at[stands] > stamp - round(RESTING_S * 1e9)
        self._moved.remove(stands[~is_recent])
        return stands[is_recent]
