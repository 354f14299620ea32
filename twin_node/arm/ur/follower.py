"""A trajectory followed in stretched time: slowed along its own path, never cut off it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.errors import ArmError
from twin_node.arm.path import ahead_offsets, sample_path
from twin_node.arm.ur.braking import LOOKAHEAD_S
from twin_node.robot import ArmModel
from twin_node.scene import Float64, JointPath

_START_TOLERANCE_RAD = 0.05
"""A trajectory must begin so near to the arm: servoJ would take the rest in one step. 3 degrees."""
_SPEED_TOLERANCE = 1.05
"""Joint speeds between two points may exceed the arm's ratings by this factor: rounding in the planner."""
_LEAST_RATE_CHANGE_PER_S = 1.0
"""Where the path hardly moves, the rate may still change only as fast as from rest to full in one second."""
_MOST_RATE_CHANGE_PER_S = 50.0
"""Where the path stands still, any rate is as good: 20 ms from rest to full keep the rate smooth."""
_STANDS_RAD = 0.01
"""The arm stands where so little of what it was sent is left: behind a look-ahead of 0.1 s that is 0.1 rad/s."""


class PathFollower:
    """Where the arm should be along a path, whose time runs at a rate between 0 and 1 that changes only gently."""

    def __init__(
        self, model: ArmModel, path: JointPath, q: NDArray[np.floating], lookahead_s: float = LOOKAHEAD_S
    ) -> None:
        """`path` from its first stamp on, whatever that stamp is; `q` [J] rad is where the arm stands.

        `lookahead_s` is servoJ's, behind which the arm comes where it is sent.

        Raises `ArmError` or `RobotError` for a path that the arm cannot follow from there.
        """
        positions = _checked(model, path, q)
        self._model = model
        self._lookahead_s = lookahead_s
        self._path = JointPath(model.joint_names, path.stamps - path.stamps[0], positions)
        self._time_ns = 0.0
        self._arm_ns = 0.0
        """Time on the path at which the arm itself is, behind servoJ's look-ahead, ns."""
        self._rate = 0.0
        self._is_left = False

    @property
    def is_done(self) -> bool:
        """Whether the arm is to go no further: at the path's end, or where it stands on one that was left."""
        return bool(self._time_ns >= self._path.stamps[-1]) or (self._is_left and self._rate == 0)

    @property
    def is_left(self) -> bool:
        """Whether the path's end is not wanted any more."""
        return self._is_left

    @property
    def is_braking(self) -> bool:
        """Whether the arm still moves on the path, though it may be let go no further."""
        if self._rate > 0:
            return True
        arm, sent = self._at(np.array([self._arm_ns, self._time_ns]))
        return bool(np.abs(sent - arm).max() > _STANDS_RAD)

    @property
    def q(self) -> Float64:
        """Angles [J] that the arm is sent now, rad: it comes there behind servoJ's look-ahead."""
        position: Float64 = self._at(np.array([self._time_ns]))[0]
        return position

    def leave(self) -> None:
        """From now on brake on the path as at a fraction of 0, and stay where that ends."""
        self._is_left = True

    def advance(self, fraction: float, dt: float) -> Float64:
        """Angles [J] to send one period `dt` (s) later, while a share `fraction` of the speed is allowed.

        The rate approaches the fraction as fast as the joints' accelerations let the arm brake or start on the path.
        """
        step = self._rate_change_per_s() * dt
        allowed = 0.0 if self._is_left else fraction
        self._rate += float(np.clip(allowed - self._rate, -step, step))
        self._time_ns = min(self._time_ns + self._rate * dt * 1e9, float(self._path.stamps[-1]))
        self._arm_ns += (self._time_ns - self._arm_ns) * min(dt / self._lookahead_s, 1.0)
        return self.q

    def ahead(self, stamp: int) -> JointPath:
        """The next 200 ms from a time on (ns) at the path's own speed, from where the arm itself is by now.

        Once the path is done, the arm goes to where that ends and stands.
        """
        offsets = ahead_offsets()
        times = offsets + self._arm_ns
        if self.is_done:
            times = np.minimum(times, self._time_ns)
        return JointPath(self._model.joint_names, stamp + offsets, self._at(times))

    def _at(self, times: NDArray[np.floating]) -> Float64:
        return sample_path(self._path, np.rint(times).astype(np.int64))

    def _rate_change_per_s(self) -> float:
        """Largest change of the rate that no joint's acceleration forbids, where the path is now."""
        speeds = np.abs(np.diff(self._at(self._time_ns + np.array([-5e6, 5e6])), axis=0)[0]) / 0.01
        allowed = self._model.max_acceleration / np.maximum(speeds, 1e-6)
        return float(np.clip(allowed.min(), _LEAST_RATE_CHANGE_PER_S, _MOST_RATE_CHANGE_PER_S))


def _checked(model: ArmModel, path: JointPath, q: NDArray[np.floating]) -> Float64:
    """The path's positions [T, J] in the model's order; raises where it cannot be followed from `q`."""
    sample_path(path, path.stamps[:1])
    positions = model.order(path.names, path.positions)
    away = np.abs(positions[0] - q)
    if away.max() > _START_TOLERANCE_RAD:
        joint = int(away.argmax())
        raise ArmError(
            f"trajectory: expected to begin where the arm stands, found {model.joint_names[joint]} {away[joint]:.2f} "
            f"rad away (at most {_START_TOLERANCE_RAD:g}); plan it from the arm's present joints"
        )
    outside = (positions < model.lower) | (positions > model.upper)
    if outside.any():
        joint = int(np.argwhere(outside)[0][1])
        raise ArmError(
            f"trajectory: expected {model.joint_names[joint]} within {model.lower[joint]:.2f} to "
            f"{model.upper[joint]:.2f} rad, found a point outside; plan it within the joints' ranges"
        )
    if len(path.stamps) > 1:
        speeds = np.abs(np.diff(positions, axis=0)) / (np.diff(path.stamps)[:, None] * 1e-9)
        excess = (speeds / model.max_velocity).max(axis=0)
        if excess.max() > _SPEED_TOLERANCE:
            joint = int(excess.argmax())
            raise ArmError(
                f"trajectory: expected {model.joint_names[joint]} at {model.max_velocity[joint]:.2f} rad/s at most, "
                f"found {excess[joint] * model.max_velocity[joint]:.2f}; give it more time"
            )
    return positions
