"""What the controller's motion commands make of its targets, period by period."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twin_node.arm import CyclicPath
from twin_node.scene import Float64

SERVO_ACCELERATION = 40.0
"""rad/s^2: the largest acceleration that servoj accepts (URScript)."""
STOP_DECELERATION = 10.0
"""rad/s^2: URScript's default of stopl and speed stops; what ends a program decelerates so."""
_STANDING = 1e-4
"""rad/s below which a joint stands."""


@dataclass
class Target:
    """Where the controller wants the joints to be."""

    q: Float64
    """[6] rad."""
    qd: Float64
    """[6] rad/s."""

    @property
    def is_standing(self) -> bool:
        """Whether no joint is meant to move."""
        return bool(np.abs(self.qd).max() < _STANDING)


class Motion(Protocol):
    """A motion in progress."""

    @property
    def is_done(self) -> bool:
        """Whether it has come to its end."""

    @property
    def can_be_slowed(self) -> bool:
        """Whether the speed slider slows it; what it does not slow is stopped off its path by a pause."""

    def advance(self, target: Target, dt: float, scale: float) -> Target:
        """The target one period of `dt` s later, at a share `scale` of the programmed speed."""


class Hold:
    """Stay; also the way to a standstill from any motion: every joint decelerates on its own."""

    can_be_slowed = False

    def __init__(self, deceleration: float = STOP_DECELERATION) -> None:
        self._deceleration = max(deceleration, 0.1)
        self.is_done = False

    def advance(self, target: Target, dt: float, scale: float) -> Target:
        """Brake; the speed slider does not make a stop slower."""
        qd = _towards(target.qd, np.zeros(6), self._deceleration * dt)
        self.is_done = bool(np.abs(qd).max() < _STANDING)
        return Target(target.q + qd * dt, qd)


class MoveJ:
    """A trapezoidal velocity in joint space, all joints in step with the one that takes longest."""

    can_be_slowed = True

    def __init__(self, start: Float64, goal: Float64, speed: float, acceleration: float) -> None:
        self._start = start
        self._way = goal - start
        length = max(float(np.abs(self._way).max()), 1e-9)
        speed, acceleration = max(speed, 1e-3), max(acceleration, 1e-3)
        peak = min(speed, float(np.sqrt(acceleration * length)))
        self._ramp_s = peak / acceleration
        self._cruise_s = length / peak - self._ramp_s
        self._time = 0.0

    @property
    def duration_s(self) -> float:
        """Time it takes at full speed, s."""
        return 2 * self._ramp_s + self._cruise_s

    @property
    def progress(self) -> float:
        """Share of its time that has passed."""
        return min(self._time / self.duration_s, 1.0)

    @property
    def is_done(self) -> bool:
        """Whether the goal is reached."""
        return self._time >= self.duration_s

    def advance(self, target: Target, dt: float, scale: float) -> Target:
        """The next target on the way; the way does not depend on the scale."""
        self._time += dt * scale
        q = self._start + self._way * self._share(self._time)
        qd = np.zeros(6) if self.is_done else (q - target.q) / dt
        return Target(q, qd)

    def _share(self, time: float) -> float:
        """Share of the way that is done at a time."""
        total = self._ramp_s + self._cruise_s
        left = self.duration_s - time
        if left <= 0:
            return 1.0
        if time < self._ramp_s:
            return time**2 / (2 * self._ramp_s * total)
        if left < self._ramp_s:
            return 1.0 - left**2 / (2 * self._ramp_s * total)
        return (time - self._ramp_s / 2) / total


class FollowCycle:
    """A joint path that repeats for ever; the speed slider stretches its time."""

    is_done = False
    can_be_slowed = True

    def __init__(self, path: CyclicPath) -> None:
        self._path = path
        self._time_ns = 0.0

    def advance(self, target: Target, dt: float, scale: float) -> Target:
        """The next target along the cycle."""
        self._time_ns += dt * scale * 1e9
        q = self._path.at(round(self._time_ns))
        return Target(q, (q - target.q) / dt)


class ServoJ:
    """Follows a goal that is set again and again; between settings it goes on to the last one, for ever."""

    is_done = False
    can_be_slowed = False

    def __init__(self, goal: Float64, lookahead_s: float, max_velocity: Float64) -> None:
        self._goal = goal
        self._lookahead_s = max(lookahead_s, 0.03)
        self._max_velocity = max_velocity

    def advance(self, target: Target, dt: float, scale: float) -> Target:
        """Close in on the goal within the look-ahead time; servoj knows no speed slider."""
        wanted = (self._goal - target.q) / self._lookahead_s
        wanted = np.minimum(np.maximum(wanted, -self._max_velocity), self._max_velocity)
        qd = _towards(target.qd, wanted, SERVO_ACCELERATION * dt)
        return Target(target.q + qd * dt, qd)


class SpeedJ:
    """Keeps joint velocities until told otherwise."""

    is_done = False
    can_be_slowed = True

    def __init__(self, velocities: Float64, acceleration: float) -> None:
        self._velocities = velocities
        self._acceleration = max(acceleration, 1e-3)

    def advance(self, target: Target, dt: float, scale: float) -> Target:
        """Accelerate towards the velocities, scaled by the speed slider."""
        qd = _towards(target.qd, self._velocities * scale, self._acceleration * dt)
        return Target(target.q + qd * dt, qd)


def _towards(current: Float64, wanted: Float64, step: float) -> Float64:
    """Each element moved towards what is wanted, by `step` at most."""
    moved: Float64 = current + np.minimum(np.maximum(wanted - current, -step), step)
    return moved
