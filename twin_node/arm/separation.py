"""Speed and separation monitoring of ISO/TS 15066, inverted: the largest share of its speed at which an arm may go on.

S = S_h + S_r + S_s + C + Z (5.5.4, eq. 3), per pair of a capsule and an obstacle. The obstacles already are a forecast
of where something may be, so S_h grows only from the end of their validity on. Not a safety-rated function.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.checker import Approaches
from twin_node.arm.course import ArmMotion, Course
from twin_node.arm.errors import ArmError
from twin_node.arm.obstacle_set import SAME_LAYER_NS, ObstacleSet
from twin_node.ranges import NOT_NEGATIVE, Range, check_ranges
from twin_node.scene import Bool, Float64, ObstacleKind

_BISECTIONS = 10
"""Halvings of the speed share's interval: exact to 0.1 %."""
_LARGEST_CLOSING = 0.25
"""m/s, what ISO 10218-1 calls reduced speed: a law for nothing slower is none. Who gives more means millimetres."""


class UnknownPolicy(Enum):
    """How space that no camera sees is treated."""

    LAW = "law"
    """Something may come out of what is UNKNOWN: as MOVING. UNSEEN may be full: as STATIC."""
    CLEARANCE = "clearance"
    """It may be full, but nothing comes out of it: both as STATIC."""
    IGNORE = "ignore"
    """Neither is looked at: for cells whose unseen space is known to be empty."""


@dataclass(frozen=True)
class SeparationParameters:
    """Constants of the law."""

    human_speed: float = 1.6
    """v_h beyond the forecast, m/s: walking speed of ISO 13855; a faster obstacle counts with its measured speed."""
    intrusion_m: float = 0.2
    """C: how far a body reaches past what the sensors detect, m."""
    clearance_m: float = 0.03
    """Kept from what stands still, m: about one voxel. What moves and may come nearer stops an arm that leaves, too."""
    position_error_m: float = 0.005
    """Z: error of the arm's position, m: DH parameters without factory calibration are off by millimetres.

    The error of the obstacles is inside their shapes already.
    """
    closing_speed: float = 0.01
    """A pair that comes closer slower than this, m/s, is not closing."""
    unknown: UnknownPolicy = UnknownPolicy.LAW

    def __post_init__(self) -> None:
        """Raises `ArmError` for a constant that is negative or not finite, and for a law that holds for nothing."""
        check_ranges(
            self,
            ArmError,
            "separation: ",
            human_speed=NOT_NEGATIVE,
            intrusion_m=NOT_NEGATIVE,
            clearance_m=NOT_NEGATIVE,
            position_error_m=NOT_NEGATIVE,
            closing_speed=Range(0, _LARGEST_CLOSING),
        )


@dataclass(frozen=True)
class Terms:
    """Protective distances and their parts, m; one value per pair."""

    human: Float64
    reaction: Float64
    stopping: Float64
    intrusion: Float64
    uncertainty: Float64

    @property
    def required(self) -> Float64:
        """The sum."""
        return self.human + self.reaction + self.stopping + self.intrusion + self.uncertainty


@dataclass(frozen=True)
class Reaches:
    """How far what was seen gets from where it was seen, by the forecast's calibrated bound."""

    speeds: Float64
    """[n] m/s; 0 for obstacles of which the forecast does not say it."""
    delays: Float64
    """[n] s from the evidence on."""
    evidence: int
    """ns."""
    begins: int
    """When the forecast begins to say it, ns."""
    ends: int
    """And until when, ns."""

    def until(self, stamp: int, speeds: Float64) -> Float64:
        """[n] m by a time (ns): before the forecast as far as at its beginning, after it on at `speeds` [n] (m/s)."""
        told_s = (min(max(stamp, self.begins), self.ends) - self.evidence) * 1e-9
        reach = self.speeds * np.maximum(told_s - self.delays, 0) + speeds * (max(stamp - self.ends, 0) * 1e-9)
        return np.where(self.speeds > 0, reach, np.inf)


@dataclass(frozen=True)
class Hazards:
    """Per obstacle: how the law looks at it."""

    counts: Bool
    """[n] False where it is out of date or left out by the policy."""
    keeps_still: Bool
    """[n] True where plain clearance is enough."""
    moves: Bool
    """[n] True where something was seen to move, or may by then."""
    speeds: Float64
    """[n] v_h, m/s: their own, and a person's at least."""
    going_on: Float64
    """[n] as fast as which they may overtake an arm that leaves, m/s: their own speed where a forecast tells how they
    come there, v_h where nobody does."""
    valid_from: NDArray[np.int64]
    """[n] ns."""
    valid_to: NDArray[np.int64]
    """[n] ns; for ever where a later layer takes over."""
    as_seen: Bool
    """[n] True for what moved where it was seen, beside a forecast of it: the second proof."""
    begins_with: Bool
    """[n] True for what the forecast of what moves begins with: its first layer."""
    begins: int
    """When the forecast begins, ns."""
    reaches: Reaches | None
    """How far the forecast lets what was seen get; None where it does not say."""

    def gone(self, stamp: int) -> Float64:
        """How far [n] obstacles may be from where they are valid by a time (ns), m: at v_h, or less by the forecast."""
        free: Float64 = self.speeds * (np.maximum(stamp - self.valid_to, 0) * 1e-9)
        if self.reaches is None:
            return free
        return np.where(self.as_seen, np.minimum(free, self.reaches.until(stamp, self.speeds)), free)


def hazards(obstacles: ObstacleSet, stamp: int, parameters: SeparationParameters) -> Hazards:
    """How the law looks at obstacles at a time (ns).

    What stands still is valid for ever. Another obstacle ends with its validity, if a later layer of its kind's
    forecast takes over: else it goes on, and grows. So does, from the evidence on, what was seen. What the first layer
    holds may be there before that begins: a forecast begins when it is expected to be read, at times after it is.
    Evidence of the future is no younger than now: the clocks differ, and by as much all that it says is earlier.
    """
    obstacles = _no_younger(obstacles, stamp)
    source, kinds = obstacles.source, obstacles.kinds
    unknown = np.asarray(kinds == ObstacleKind.UNKNOWN)
    is_furniture = parameters.unknown is UnknownPolicy.CLEARANCE
    keeps_still = obstacles.is_static | obstacles.is_unseen | (unknown & is_furniture)
    goes_on = keeps_still | obstacles.goes_on
    as_seen = obstacles.as_seen & ~goes_on
    counts = (source.valid_to >= stamp) | goes_on | as_seen
    counts &= ~((unknown | obstacles.is_unseen) & (parameters.unknown is UnknownPolicy.IGNORE))
    own_speeds = np.linalg.norm(source.velocities, axis=1)
    speeds = np.maximum(own_speeds, parameters.human_speed)
    is_first = source.valid_from <= obstacles.begins + SAME_LAYER_NS
    return Hazards(
        counts=np.asarray(counts),
        keeps_still=keeps_still,
        moves=np.asarray(kinds == ObstacleKind.MOVING),
        speeds=speeds,
        going_on=np.where(obstacles.as_seen, speeds, own_speeds),
        valid_from=np.where(is_first, stamp, source.valid_from),
        valid_to=np.where(goes_on | as_seen, source.valid_to, np.iinfo(np.int64).max),
        as_seen=as_seen,
        begins_with=np.asarray(kinds == ObstacleKind.MOVING) & ~as_seen & is_first,
        begins=obstacles.begins,
        reaches=_reaches(obstacles),
    )


def _no_younger(obstacles: ObstacleSet, stamp: int) -> ObstacleSet:
    """Obstacles whose evidence is of a time (ns) at the latest."""
    source = obstacles.source
    early = source.stamp - stamp
    if early <= 0:
        return obstacles
    valid_from, valid_to = source.valid_from - early, source.valid_to - early
    return replace(obstacles, source=replace(source, stamp=stamp, valid_from=valid_from, valid_to=valid_to))


def _reaches(obstacles: ObstacleSet) -> Reaches | None:
    """As the obstacles say them; nobody forecast what is valid at the evidence alone."""
    source, ends = obstacles.source, obstacles.last_valid(ObstacleKind.MOVING)
    if source.reach_speeds is None or source.reach_delays is None or ends is None or ends <= source.stamp:
        return None
    return Reaches(source.reach_speeds, source.reach_delays, source.stamp, obstacles.begins, ends)


class Proof(IntEnum):
    """What a pair speaks of: for a capsule the law is to hold by the forecast or by sight."""

    EVERY = 0
    """Both: what stands, and what is unknown."""
    FORECAST = 1
    """By the forecast: its layers."""
    SIGHT = 2
    """By sight: what was seen, until the arm stands."""
    SEEN_BEFORE = 3
    """By the forecast, which tells nothing of the time until it begins: what was seen, as far as it gets by then. Plain
    clearance is kept meanwhile: most of that time is over when the arm obeys."""
    FIRST_BEFORE = 4
    """The same from the other end: the first layer, and how far from it what is in it by then may be now. For a capsule
    one of the two is enough."""


@dataclass(frozen=True)
class Encounter:
    """Pairs of capsules and obstacles, and the motion that the law is applied to."""

    hazards: Hazards
    proofs: NDArray[np.int64]
    """[p] values of `Proof`."""
    capsules: NDArray[np.int64]
    """[p] each pair's capsule."""
    rows: NDArray[np.int64]
    """[p] row of each pair's obstacle."""
    distances: Float64
    """[p] from the arm as it stands now to the obstacle as it will be, m."""
    closing: Float64
    """[p] speed at which the arm, at full speed, comes closer by its own motion, m/s."""
    motion: ArmMotion
    parameters: SeparationParameters

    @staticmethod
    def of(
        hazards: Hazards, pairs: Approaches, closing: Float64, motion: ArmMotion, parameters: SeparationParameters
    ) -> Encounter:
        """What is to be looked at of pairs that come closer at speeds `closing` [p] (m/s) by the arm's own motion."""
        rows = pairs.obstacles
        proofs = np.where(hazards.as_seen, Proof.SIGHT, np.where(hazards.moves, Proof.FORECAST, Proof.EVERY))[rows]
        seen, first = np.zeros((2, 0), np.int64)
        if hazards.begins > motion.stamp:
            seen, first = np.flatnonzero(hazards.as_seen[rows]), np.flatnonzero(hazards.begins_with[rows])
        of = np.concatenate([np.arange(len(rows)), seen, first])
        again = np.repeat([Proof.SEEN_BEFORE, Proof.FIRST_BEFORE], [len(seen), len(first)])
        return Encounter(
            hazards,
            np.concatenate([proofs, again]),
            pairs.capsules[of],
            rows[of],
            pairs.distances[0, of],
            closing[of],
            motion,
            parameters,
        )

    def terms(self, share: float) -> Terms:
        """The law's terms at a share (0 to 1) of the arm's speed."""
        return self._terms(self.motion.course(share))

    def _terms(self, course: Course) -> Terms:
        """The terms for what the arm does."""
        left_s = np.array([np.inf, np.inf, np.inf, self._until_begin_s, 0.0])  # by proof
        steady_s = np.minimum(left_s, course.steady_s)
        braking_s = np.minimum(np.maximum(left_s - course.steady_s, 0.0), course.braking_s)
        return Terms(
            human=np.where(self._still, 0.0, self._gone(self.motion.standstill(course))),
            reaction=self.closing * steady_s[self.proofs],
            stopping=self.closing * braking_s[self.proofs],
            intrusion=self._intrusion,
            uncertainty=np.full(len(self.rows), self.parameters.position_error_m),
        )

    @cached_property
    def _still(self) -> Bool:
        """[p] whether plain clearance from the obstacle is enough."""
        return self.hazards.keeps_still[self.rows]

    @cached_property
    def _is_before(self) -> Bool:
        """[p] whether the pair speaks of the time until the forecast begins."""
        return np.asarray(self.proofs >= Proof.SEEN_BEFORE)

    @cached_property
    def _intrusion(self) -> Float64:
        law = self.parameters
        return np.where(self._still | self._is_before, law.clearance_m, law.intrusion_m)

    @cached_property
    def at_full_speed(self) -> Float64:
        """[p] `shortfall` at all of the arm's speed, m."""
        return self.shortfall(1.0)

    def shortfall(self, share: float) -> Float64:
        """By how much [p] distances fall short of the protective ones at a share of the speed, m; negative: enough.

        Minus infinity for pairs that need not be looked at: the law holds for a capsule where it holds against the
        forecast of what moves, or against what was seen to move and may have gone anywhere since at the law's speed,
        as far as its forecast lets it. Either proves that nothing that moves touches it: the one that leaves more
        counts. So does the better of two ways to tell where what is forecast was before.
        """
        alone = self._alone(share)
        worst = np.full((len(Proof), self._capsule_count), -np.inf)
        np.maximum.at(worst.reshape(-1), self._cells, alone)
        if not self.hazards.as_seen.any():
            worst[[Proof.SIGHT, Proof.SEEN_BEFORE]] = np.inf  # nobody says where it was
        by_layer = worst[Proof.FIRST_BEFORE] < worst[Proof.SEEN_BEFORE]
        before = np.minimum(worst[Proof.FIRST_BEFORE], worst[Proof.SEEN_BEFORE])
        by_sight = worst[Proof.SIGHT] < np.maximum(worst[Proof.FORECAST], before)
        kept = np.stack([np.ones_like(by_sight), ~by_sight, by_sight, ~by_sight & ~by_layer, ~by_sight & by_layer])
        return np.where(kept.reshape(-1)[self._cells], alone, -np.inf)

    @cached_property
    def _capsule_count(self) -> int:
        return int(self.capsules.max(initial=0)) + 1

    @cached_property
    def _cells(self) -> NDArray[np.int64]:
        """[p] place of each pair's proof and capsule in a table of them, row by row."""
        cells: NDArray[np.int64] = self.proofs * self._capsule_count + self.capsules
        return cells

    def _alone(self, share: float) -> Float64:
        """Shortfalls [p] of the pairs, each by itself, m.

        Minus infinity for obstacles that come after the arm would have stopped, and for pairs that the arm does not
        close, unless something that moves may touch it: whoever overtakes an arm that leaves is to find it standing.
        A forecast tells where that is, and after it things go on as fast as they are; what was seen may have come from
        there until the arm stands.
        """
        course = self.motion.course(share)
        standstill = self.motion.standstill(course)
        terms = self._terms(course)
        after_s = np.maximum(standstill - self.hazards.valid_to, 0) * 1e-9
        goes_on = (self.hazards.going_on * after_s)[self.rows]
        touches = np.where(self.proofs >= Proof.SIGHT, terms.human, goes_on)
        touches += self._within_touch
        concerned = self._moves & (self.distances < touches)
        concerned |= self._closes
        concerned &= self._valid_from <= standstill
        return np.where(concerned, terms.required - self.distances, -np.inf)

    @cached_property
    def _moves(self) -> Bool:
        return self.hazards.moves[self.rows]

    @cached_property
    def _closes(self) -> Bool:
        """[p] whether the arm comes closer by its own motion."""
        return np.asarray(self.closing > self.parameters.closing_speed)

    @cached_property
    def _valid_from(self) -> NDArray[np.int64]:
        return self.hazards.valid_from[self.rows]

    def _gone(self, standstill: int) -> Float64:
        """How far [p] obstacles may be from where they are valid by a standstill (ns), or before the forecast, m."""
        gone = self.hazards.gone(standstill)
        if not self._is_before.any():
            of_pairs: Float64 = gone[self.rows]
            return of_pairs
        by_begin = self.hazards.gone(min(standstill, self.hazards.begins))
        before_layer = self.hazards.speeds * self._until_begin_s
        return np.stack([gone, gone, gone, by_begin, before_layer])[self.proofs, self.rows]

    @property
    def _until_begin_s(self) -> float:
        """Time from now until the forecast begins, s; pairs that ask for it are there only where that is to come."""
        return (self.hazards.begins - self.motion.stamp) * 1e-9

    @property
    def _within_touch(self) -> float:
        """Distance at which something may touch the arm, m."""
        return self.parameters.clearance_m + self.parameters.position_error_m

    def largest_share(self) -> float:
        """Largest share (0 to 1) of the arm's speed at which no pair falls short.

        Every term rises with the share, and so does the lesser of two proofs, so bisection finds it.
        """
        if (self.at_full_speed <= 0).all():
            return 1.0
        if not self._holds(0.0):
            return 0.0
        low, high = 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            low, high = (middle, high) if self._holds(middle) else (low, middle)
        return low

    def _holds(self, share: float) -> bool:
        """Whether no pair falls short at a share of the speed; of one that is not a number nobody knows."""
        return bool((self.shortfall(share) <= 0).all())
