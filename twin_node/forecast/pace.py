"""The pace at which evidence comes: what was known of motion before a pause says nothing of the motion after it."""

from __future__ import annotations

from collections import deque
from statistics import median

LONGEST_GAP_S = 0.5
"""After a longer time without evidence nothing is known of how things move, nor of space that is not seen, s."""
_SHORTEST_PAUSE_S = 0.25
"""What comes sooner is no pause, s. Of a ball that goes to and fro at up to 1.5 m/s, 0.8 or 1.5 times a second, seen at
30 Hz, the first forecast after 0.2 s without evidence holds 99 to 100 %, as any other; without depth those after 0.27
to 0.5 s would hold 89 to 99 % if motion were gone on with, 46 % at worst, and with or without those after 0.67 s 66 to
90 %."""
USUAL_STEPS = 3.5
"""What takes no longer than so many usual steps is no pause either: bounds are learnt from such forecasts. One set
missing of five per second, or two of ten."""
_REMEMBERED = 15
"""Steps that the usual one is the median of: half a second's at 30 Hz, three seconds' at 5 Hz."""


class Pace:
    """Tells pauses in the evidence, stamp by stamp."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._steps_s: deque[float] = deque(maxlen=_REMEMBERED)

    def pauses_before(self, stamp: int) -> bool:
        """Takes in the next stamp (ns, rising): whether there was a pause before it, longer than usual steps allow."""
        last, self._last = self._last, stamp
        if last is None:
            return False
        usual_s, step_s = median(self._steps_s or [0.0]), (stamp - last) * 1e-9
        self._steps_s.append(step_s)
        return step_s > min(max(USUAL_STEPS * usual_s, _SHORTEST_PAUSE_S), LONGEST_GAP_S)
