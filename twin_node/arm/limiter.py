"""Makes a speed out of decisions over time: down at once, up slowly, and to a stop when no forecast comes."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace

from twin_node.arm.errors import ArmError
from twin_node.ranges import POSITIVE, SHARE, Range, check_ranges
from twin_node.scene import NO_EVIDENCE, Separation

_RISING = "; speeding up"
"""Said after the reason of a decision for full speed that the arm is still on its way to."""
_COMING_S = 1.0
"""Where one has come within this time forecasts do come, s, be they slow."""
_LONGEST_S = 10.0
"""No arm goes on for so long without a forecast, s: who gives more means milliseconds."""


@dataclass(frozen=True)
class LimiterParameters:
    """How the speed follows the decisions."""

    deadline_s: float = 0.1
    """Time without a forecast after which the arm is slow; after twice as long it stands. Three images at 30 Hz."""
    slow_fraction: float = 0.2
    """Largest speed between one and two deadlines."""
    rise_per_s: float = 1.33
    """How fast the speed may rise: from rest to full in 0.75 s, as a UR's moveJ does by default (1.4 rad/s^2 to 1.05
    rad/s). A matter of the arm's load and of calm: the law itself allows each decision's speed at once."""
    evidence_latency_s: float = 0.2
    """Age that evidence may have when its forecast arrives; older evidence counts as a late forecast."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for values with which nothing would stop, or nothing go."""
        check_ranges(
            self,
            ArmError,
            "limiter: ",
            deadline_s=Range(0, _LONGEST_S, above=True),
            evidence_latency_s=Range(0, _LONGEST_S),
            slow_fraction=SHARE,
            rise_per_s=POSITIVE,
        )


class SpeedLimiter:
    """Speed fraction that the arm is given, from the decisions made so far and the time since the last.

    Any thread may call it: decisions come from one that a camera may hold up, and another's timer asks meanwhile.
    """

    def __init__(self, parameters: LimiterParameters | None = None) -> None:
        self.parameters = parameters or LimiterParameters()
        self._decision: Separation | None = None
        self._arrival = 0
        self._fraction = 0.0
        self._stamp: int | None = None
        self._lock = threading.Lock()

    def decide(self, separation: Separation, now: int) -> Separation:
        """Takes a new decision at a time (ns) and gives back what the arm is told: `tick` at that time.

        Where nobody has asked for longer than a deadline, it rises from what the arm would have been told by now.
        Raises `ArmError` for a speed that is no share of 0 to 1: what was told before goes on, and gets old.
        """
        if not 0 <= separation.speed_fraction <= 1:
            raise ArmError(f"decision: expected a speed fraction of 0 to 1, found {separation.speed_fraction}")
        with self._lock:
            if self._stamp is not None and (now - self._stamp) * 1e-9 > self.parameters.deadline_s:
                self._tick(now)
            self._decision = separation
            self._arrival = now
            return self._tick(now)

    def tick(self, now: int) -> Separation:
        """What the arm is told at a time (ns), called at least once per deadline whether or not a forecast came.

        Before the first decision the arm stands.
        """
        with self._lock:
            return self._tick(now)

    def _tick(self, now: int) -> Separation:
        if self._decision is None:
            self._stamp = now
            return standing(now, NO_EVIDENCE, f"stopped: {self._lack(now)}")
        self._arrival = min(self._arrival, now)  # a clock that was put back must not make a forecast last
        limit, reason = self._decision.speed_fraction, self._decision.reason
        age_s = self.silence_s(now)
        if self._decision.evidence_stamp == NO_EVIDENCE:
            limit, reason = 0.0, reason if limit == 0 else "stopped: nobody knows how old the evidence is; stamp it"
        elif age_s >= 2 * self.parameters.deadline_s:
            limit, reason = 0.0, f"stopped: {self._lack(now)}"
        elif age_s >= self.parameters.deadline_s and limit > self.parameters.slow_fraction:
            limit, reason = self.parameters.slow_fraction, f"slow: {self._lack(now)}"
        elapsed_s = 0.0 if self._stamp is None else max(now - self._stamp, 0) * 1e-9
        self._fraction = min(limit, self._fraction + self.parameters.rise_per_s * elapsed_s)
        self._stamp = now
        if self._fraction < limit == 1:
            reason += _RISING  # "clear" alone would be no reason to be slow
        return replace(self._decision, stamp=now, speed_fraction=self._fraction, reason=reason)

    def stand(self) -> None:
        """The arm stands, whatever it was told: from now on its speed rises from there."""
        with self._lock:
            self._fraction = 0.0

    def silence_s(self, now: int) -> float:
        """How long there has been no fresh forecast at a time (ns), s; infinite before the first."""
        if self._decision is None:
            return math.inf
        return max(now - self._arrival, now - self._decision.evidence_stamp - self._latency_ns()) * 1e-9

    def lack(self, now: int) -> str:
        """What is missing after a silence that lasts at a time (ns): no forecast comes, or none young enough."""
        with self._lock:
            return self._lack(now)

    def _lack(self, now: int) -> str:
        """Where forecasts come all the same, who sends them is not to be sought."""
        if self._decision is None:
            return "no forecast yet"
        age_s = self.silence_s(now)
        if (now - self._arrival) * 1e-9 >= min(age_s, _COMING_S):
            return f"no forecast for {age_s * 1e3:.0f} ms"
        late_ms = (self._arrival - self._decision.evidence_stamp) / 1e6
        return (
            f"no forecast that is young enough: those that come are of {late_ms:.0f} ms before (a slow twin, or clocks "
            "that differ)"
        )

    def _latency_ns(self) -> int:
        return round(self.parameters.evidence_latency_s * 1e9)


def standing(stamp: int, evidence_stamp: int, reason: str) -> Separation:
    """A decision that the arm stands, where no distance can be told; stamps are ns."""
    return Separation.without_pair(stamp, evidence_stamp, 0.0, reason)
