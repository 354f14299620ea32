"""Slider mode's hand on the arm: the robot runs its own program, which the speed slider and the heartbeat hold back."""

from __future__ import annotations

from collections import deque

from twin_node.arm.errors import ArmError
from twin_node.arm.ur.link import UrLink
from twin_node.arm.ur.sample import UrSample

_RESEND_S = 0.1
"""The slider is set again this often, so that nobody else's setting stays."""
_CONTRADICT_S = 0.02
"""And this often while it is above what it was set to: within this time a controller has told what it was set to."""
_ECHO_S = 0.1
"""Until then the slider may still show what it was set to before: fifty of the controller's periods."""
_OBEY_S = 0.1
"""Beyond that it may be above for so long in all, be it at once or again and again: a dragging hand lets go of it."""
_FORGIVEN = 1 / 8
"""How fast that is forgotten while the slider obeys."""
_LONGEST_LOOK_S = 0.02
"""No more is counted from one look to the next: a driver that was held up does not know for how long it was above."""
_CHANGES_KEPT = 64
"""Twice as many as a driver that looks every 4 ms makes until the first is not looked at any more."""
_OBEY_TOLERANCE = 0.02
"""How far it may be above: the pendant rounds to per cent."""
_DEAF_S = 2.0
"""Above for so long without a break, it is set a hundred times in vain: nothing that is written arrives."""
_HELD_S = 1.0
"""A slider that is lower than it was set to for so long is held there: it was set ten times meanwhile."""
_UNWATCHED_S = 2.0
"""A program that watches the heartbeat has paused so long after the last: its watchdog's period, and what it brakes."""
_STEP = 0.005
"""Smallest change of the speed that is worth a package."""


class Slider:
    """Moves the speed slider, beats for the program's watchdog, and sees whether the controller obeys. Times are ns."""

    def __init__(self, link: UrLink) -> None:
        self._link = link
        self._fraction: float | None = None
        self._stamp = 0
        self._before: deque[tuple[int, float]] = deque(maxlen=_CHANGES_KEPT)
        """When it was set to something else, and what it had been set to until then."""
        self._beats = 0
        self._beaten: int | None = None
        self._is_above = False
        self._above_s = self._unbroken_s = 0.0
        self._looked = 0
        self._held_since: int | None = None

    def move(self, fraction: float, now: int) -> None:
        """Set the slider (0 to 1) where that is news, or was done a while ago. Raises `ArmError`: the link is lost."""
        before = self._fraction
        is_new = before is None or fraction == 0 < before or abs(fraction - before) >= _STEP
        if is_new or (now - self._stamp) * 1e-9 >= (_CONTRADICT_S if self._is_above else _RESEND_S):
            self._link.set_speed(fraction)
            self._before.append((now, 1.0 if before is None else before))
            self._fraction, self._stamp = fraction, now

    def beat(self, now: int) -> None:
        """Tell the program's watchdog that the driver lives. Raises `ArmError`: the link is lost."""
        self._beaten = now
        self._beats = (self._beats + 1) % 2**31
        self._link.beat(self._beats)

    def disobedience(self, sample: UrSample, now: int) -> str | None:
        """Why the slider is not where it was set to, in words; None where it is, or lower.

        Raises `ArmError` where it has not been for long: nothing else tells of a connection cut without a word.
        """
        told, passed_s = self._fraction, min((now - self._looked) * 1e-9, _LONGEST_LOOK_S)
        self._looked = now
        if told is None:
            return None
        while self._before and (now - self._before[0][0]) * 1e-9 > _ECHO_S:
            self._before.popleft()
        highest = max(told, max((fraction for _, fraction in self._before), default=0.0))
        self._is_above = sample.speed_slider > highest + _OBEY_TOLERANCE
        self._above_s = max(self._above_s + (passed_s if self._is_above else -_FORGIVEN * passed_s), 0.0)
        self._unbroken_s = self._unbroken_s + passed_s if self._is_above else 0.0
        if not self._is_above or self._above_s <= _OBEY_S:
            return None
        found = f"speed slider set to {told:.0%} reads {sample.speed_slider:.0%}"
        if self._unbroken_s > _DEAF_S:
            raise ArmError(f"{found} for {_DEAF_S:g} s: what is written does not arrive")
        return f"{found}: somebody else moves it"

    def unwatchfulness(self, sample: UrSample | None, now: int) -> str:
        """That the robot's program goes on without a heartbeat, in words after a halt's; empty where it does not.

        Where the slider does not reach it, nothing would stop it then. Before this driver's first beat a program may
        wait for that.
        """
        is_late = self._beaten is not None and (now - self._beaten) * 1e-9 > _UNWATCHED_S
        if sample is None or not sample.is_playing or not is_late:
            return ""
        return "; and the robot's program plays on without the heartbeat: let it call rtde_set_watchdog"

    def idleness(self, sample: UrSample | None, now: int) -> str:
        """Why an arm that may go does not all the same, in words after those of the decision; empty where it does."""
        told = self._fraction
        if sample is None or told is None or told <= _OBEY_TOLERANCE:
            self._held_since = None
            return ""
        if not sample.is_playing:
            return "; but no program runs on the robot; press play"
        if sample.speed_slider >= told - _OBEY_TOLERANCE:
            self._held_since = None
            return ""
        self._held_since = self._held_since or now
        is_held = (now - self._held_since) * 1e-9 > _HELD_S
        return f"; but the speed slider stays at {sample.speed_slider:.0%}" if is_held else ""
