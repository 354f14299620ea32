"""Clocks of cameras that are set ahead while a log is recorded: from then on their images are of the future.

A live graph knows by its own clock. A log knows its times of recording, which may lie before all stamps: there it shows
by the stamps of one camera alone, which leap while its images come as they did.
"""

from __future__ import annotations

from collections import deque
from statistics import median

LEAST_LEAP_NS = 100_000_000
"""As far ahead as a live synchroniser lets an image be."""
KEPT = 9
"""Times between images that tell how regularly a camera's come."""
OF_A_PERIOD = 0.5
"""Images that come in less than this share of their usual time catch up with what was recorded late."""


class ClocksSetAhead:
    """Learns how far each camera's stamps are ahead of their recording, and by how much one was set ahead since."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[int, int]] = {}
        """Stamp and time of recording of each camera's last image, ns."""
        self._periods: dict[str, deque[int]] = {}
        self._most_lead: int | None = None
        """How far any camera's stamp was ahead while no clock was set, ns."""
        self._ahead: dict[str, int] = {}

    def ahead_ns(self, camera: str, stamp: int, recorded: int) -> int:
        """By how much a camera's clock has been set ahead, ns; of its next image, whose times are in ns."""
        last, self._last[camera] = self._last.get(camera), (stamp, recorded)
        lead = stamp - recorded
        if last is not None:
            periods = self._periods.setdefault(camera, deque(maxlen=KEPT))
            period = recorded - last[1]
            leap = stamp - last[0] - period
            is_regular = len(periods) == KEPT and period >= OF_A_PERIOD * median(periods)
            if is_regular and leap > LEAST_LEAP_NS and self._is_beyond(lead):
                self._ahead[camera] = self._ahead.get(camera, 0) + leap
            periods.append(period)
        ahead = self._ahead.get(camera, 0)
        if not ahead:
            self._most_lead = lead if self._most_lead is None else max(self._most_lead, lead)
        return ahead

    def _is_beyond(self, lead: int) -> bool:
        """Whether a stamp is farther ahead than any was: else its images had been recorded late before."""
        return self._most_lead is not None and lead > self._most_lead + LEAST_LEAP_NS
