"""How an arm comes to a standstill: from what it does now, by way of what it is told, to its stop."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from functools import cached_property

from twin_node.arm.errors import ArmError
from twin_node.arm.stopping import Stop, StoppingTable
from twin_node.ranges import NOT_NEGATIVE, SHARE, check_ranges
from twin_node.scene import Float64


@dataclass(frozen=True)
class Underway:
    """Commands on their way to the arm: until a new one gets there it does what those say."""

    latency_s: float = 0.0
    """How long a command is on its way, s; a part of the reaction time."""
    share: float = 0.0
    """Largest share of its speed that the arm was told within that time, the command that it then obeyed included."""
    slide_s: float = 0.0
    """How long the arm's controller takes from all of its speed to none, s, where a share is what it is told: as long
    from a slow part of its program, which the stopping table tells nothing of."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for values that are negative or not finite."""
        check_ranges(
            self, ArmError, "commands underway: ", latency_s=NOT_NEGATIVE, share=NOT_NEGATIVE, slide_s=NOT_NEGATIVE
        )


class Commands:
    """The shares of its speed that an arm was told, as far as it may not have heard of them yet. Times are ns."""

    def __init__(self, latency_s: float) -> None:
        """`latency_s`: how long a command is on its way at most, s."""
        self._latency_s = latency_s
        self._told: deque[tuple[int, float]] = deque([(0, 0.0)])
        """When, and what: the last of which the arm has surely heard, then those underway."""

    def tell(self, share: float, now: int) -> None:
        """The arm is told a share (0 to 1); by a clock that was put back all that came before is underway once more.

        Raises `ArmError` for a share that is none: what was told before goes on.
        """
        if not SHARE.holds(share):
            raise ArmError(f"commands: expected a share from {SHARE}, found {share:g}; divide percentages by 100")
        if now < self._told[-1][0]:
            before = [told for _, told in self._told]
            self._told = deque([(now, min(before)), (now, max(before))])
        self._told.append((now, share))
        self._forget(now)

    def underway(self, now: int) -> Underway:
        """What the arm may still do because it was told so."""
        self._forget(now)
        return Underway(self._latency_s, max(share for _, share in self._told))

    def least(self, now: int) -> float:
        """Smallest share that it may be held to by now."""
        self._forget(now)
        return min(share for _, share in self._told)

    def _forget(self, now: int) -> None:
        while len(self._told) > 1 and now - self._told[1][0] >= self._latency_s * 1e9:
            self._told.popleft()


@dataclass(frozen=True)
class Course:
    """How an arm comes to a standstill; ways are times at its full speed: metres per m/s."""

    steady_s: float
    """Way until it is told to stop, s."""
    braking_s: float
    """Way that it brakes on, s."""
    duration_s: float
    """From now until it stands, s."""


@dataclass(frozen=True)
class ArmMotion:
    """What the law needs to know of the arm at its full programmed speed."""

    stamp: int
    """Now, ns."""
    reaction_s: float
    """T_r: from now until the arm begins to brake, s; what happened before now is in the obstacles' stamps."""
    joint_speeds: Float64
    """[J] largest over the next 200 ms, rad/s."""
    table: StoppingTable
    measured: float = 0.0
    """Share of that speed at which the arm was measured to go now; where it still brakes, more than it is told."""
    underway: Underway = field(default_factory=Underway)

    @property
    def going(self) -> float:
        """Share of that speed at which the arm goes until a command of now gets to it, at most."""
        return max(self.measured, self.underway.share)

    @cached_property
    def _stop_now(self) -> Stop:
        return self.table.stop(self.going * self.joint_speeds)

    @cached_property
    def _courses(self) -> dict[float, Course]:
        """Those asked for before, by their shares: the law asks again and again for that at full speed."""
        return {}

    def course(self, share: float) -> Course:
        """What it does if it is told a share (0 to 1) of the speed now, and nothing when the reaction time is over.

        One that is faster goes on until it hears of that, and brakes then. If it gets to its share in time, it goes on
        at that until it is told.
        """
        if share not in self._courses:
            self._courses[share] = self._slid(self._course(share), share)
        return self._courses[share]

    def _slid(self, course: Course, share: float) -> Course:
        """That course, but no sooner over, nor shorter, than its controller slides: from a share that is told now as
        soon as the next command is heard, and from what was told before as soon as this one is."""
        slide_s, before, deaf_s = self.underway.slide_s, self.underway.share, self._deaf_s
        duration_s = max(course.duration_s, self.reaction_s + share * slide_s, deaf_s + before * slide_s)
        return replace(
            course, braking_s=max(course.braking_s, max(share, before) ** 2 * slide_s / 2), duration_s=duration_s
        )

    @property
    def _deaf_s(self) -> float:
        """Until it hears of a command of now, s."""
        return min(self.underway.latency_s, self.reaction_s)

    def _course(self, share: float) -> Course:
        """By the stopping table alone."""
        stop = self.table.stop(share * self.joint_speeds)
        if share >= self.going:
            return Course(share * self.reaction_s, share * stop.travel_s, self.reaction_s + stop.duration_s)
        deaf_s = self._deaf_s
        way_s = self.going * self._stop_now.travel_s
        braking_s = 2 * (way_s - share * stop.travel_s) / (self.going + share)  # steadily, until it is no faster
        left_s = max(self.reaction_s - deaf_s - braking_s, 0.0)
        steady_s = self.going * deaf_s + share * left_s
        return Course(steady_s, way_s, deaf_s + left_s + self._stop_now.duration_s)

    def standstill(self, course: Course) -> int:
        """When the arm then stands, ns."""
        return self.stamp + round(course.duration_s * 1e9)
