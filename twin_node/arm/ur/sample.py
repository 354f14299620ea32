"""What the controller says of itself, and whether that can be true."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from twin_node.robot import ArmModel
from twin_node.scene import Float64

_VELOCITY_MARGIN = 1.5
"""Measured velocities may exceed a joint's rating by noise and overshoot; beyond this factor a number is wrong."""
_JUMP_RAD = 0.1
"""A joint may be found so far from where it was, beyond what its speed explains: packages can be left out."""
_LIMIT_RAD = 0.2
"""Joints are built to stop at their ends; measured angles beyond by this are wrong."""


class RobotMode(IntEnum):
    """RTDE `robot_mode`."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """RTDE `safety_mode`, as in UR's client library; newer controllers have more of them."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED_SAFETY_MODE = 11
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13
    TP_THREE_POSITION_ENABLING_STOP = 14
    IMMI_EMERGENCY_STOP = 15
    IMMI_SAFEGUARD_STOP = 16
    PROFISAFE_WAITING_FOR_PARAMETERS = 17
    PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP = 18
    PROFISAFE_SAFEGUARD_STOP = 19
    PROFISAFE_EMERGENCY_STOP = 20
    SAFETY_API_SAFEGUARD_STOP = 22


_MOST_SAFETY_MODE = 63
"""A mode up to here that has no name yet is one of a newer controller, and lets nothing move; numbers of a package of
the wrong layout are far beyond, or 0."""


class RuntimeState(IntEnum):
    """RTDE `runtime_state` of the robot's program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


_SAFETY_MODES = {int(mode): mode.name for mode in SafetyMode}
_ROBOT_MODES, _RUNTIME_STATES = (frozenset(int(value) for value in kind) for kind in (RobotMode, RuntimeState))


@dataclass(frozen=True)
class UrSample:
    """One state of the controller as `ur_rtde` received it, not yet checked."""

    clock_s: float
    """The controller's own clock since its start."""
    q: Float64
    """Measured angles, rad; [6] if all is well."""
    qd: Float64
    """Measured velocities, rad/s."""
    target_q: Float64
    """Commanded angles, rad."""
    target_qd: Float64
    """Commanded velocities, rad/s."""
    robot_mode: int
    safety_mode: int
    runtime_state: int
    speed_slider: float
    """Share of the programmed speed that is set, 0 to 1."""
    speed_scaling: float
    """Share of the slider's speed that the controller's own limits leave, 0 to 1."""

    @property
    def is_playing(self) -> bool:
        """Whether a program runs."""
        return self.runtime_state == RuntimeState.PLAYING

    @property
    def speed_share(self) -> float:
        """Share of the programmed speed at which the controller moves: slider times its own scaling, 1 at most."""
        return self.speed_slider * min(self.speed_scaling, 1.0)

    @property
    def is_paused(self) -> bool:
        """Whether a program waits to be gone on with."""
        return self.runtime_state in (RuntimeState.PAUSED, RuntimeState.PAUSING)

    @property
    def has_ended(self) -> bool:
        """Whether no program is there that would go on."""
        return self.runtime_state in (RuntimeState.STOPPED, RuntimeState.STOPPING)

    @property
    def may_move(self) -> bool:
        """Whether power, brakes and safety system let the arm move."""
        return self.robot_mode == RobotMode.RUNNING and self.safety_mode in (SafetyMode.NORMAL, SafetyMode.REDUCED)


def implausible(model: ArmModel, sample: UrSample, previous: UrSample | None) -> str | None:
    """Why a sample cannot be true, in words; None: it can.

    A package of the wrong layout is decoded by `ur_rtde` without complaint: its numbers land in wrong fields. So
    modes that cannot be, speeds beyond the joints' ratings and jumps are refused as much as NaN.
    """
    for name, values in (
        ("joint angles", sample.q),
        ("joint velocities", sample.qd),
        ("target angles", sample.target_q),
        ("target velocities", sample.target_qd),
    ):
        if values.shape != (model.joints,):
            return f"controller sent {values.size} {name}, expected {model.joints}"
        if not np.isfinite(values).all():
            return f"controller sent {name} that are not finite"
    if sample.robot_mode not in _ROBOT_MODES or not 0 < sample.safety_mode <= _MOST_SAFETY_MODE:
        return f"controller sent robot mode {sample.robot_mode}, safety mode {sample.safety_mode}: no such modes"
    if sample.runtime_state not in _RUNTIME_STATES or not 0 <= sample.speed_slider <= 1:
        return f"controller sent runtime state {sample.runtime_state}, speed slider {sample.speed_slider:g}: no such"
    if not 0 <= sample.speed_scaling < math.inf:
        return f"controller sent speed scaling {sample.speed_scaling:g}: no such"
    return _impossible_motion(model, sample, previous)


def not_ready(sample: UrSample) -> str | None:
    """Why the arm may not move, in words; None: it may."""
    if sample.safety_mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        return f"safety mode {_SAFETY_MODES.get(sample.safety_mode, sample.safety_mode)}: clear it on the pendant"
    if sample.robot_mode != RobotMode.RUNNING:
        return f"robot mode {RobotMode(sample.robot_mode).name}: switch power on and release the brakes"
    return None


def _impossible_motion(model: ArmModel, sample: UrSample, previous: UrSample | None) -> str | None:
    """Why no arm can be or move so, in words."""
    limit = _VELOCITY_MARGIN * model.max_velocity
    for velocities in (sample.qd, sample.target_qd):
        if np.any(np.abs(velocities) > limit):
            joint = int(np.argmax(np.abs(velocities) / limit))
            return f"controller sent {velocities[joint]:.3g} rad/s for {model.joint_names[joint]}: beyond its rating"
    for angles in (sample.q, sample.target_q):
        if np.any((angles < model.lower - _LIMIT_RAD) | (angles > model.upper + _LIMIT_RAD)):
            joint = int(np.argmax(np.maximum(model.lower - angles, angles - model.upper)))
            return f"controller sent {angles[joint]:.3g} rad for {model.joint_names[joint]}: beyond its range"
    if previous is not None:
        moved = np.abs(sample.q - previous.q)
        reach = limit * max(sample.clock_s - previous.clock_s, 0.0) + _JUMP_RAD
        if np.any(moved > reach):
            joint = int(np.argmax(moved - reach))
            return f"{model.joint_names[joint]} jumped by {moved[joint]:.2f} rad"
    return None
