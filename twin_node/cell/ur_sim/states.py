"""The controller's states, with the numbers that RTDE gives them, and what has happened to it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class RobotMode(IntEnum):
    """RTDE `robot_mode`."""

    POWER_OFF = 3
    IDLE = 5
    RUNNING = 7


class SafetyMode(IntEnum):
    """RTDE `safety_mode`."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    ROBOT_EMERGENCY_STOP = 7

    @property
    def status_bits(self) -> int:
        """RTDE `safety_status_bits`."""
        if self is SafetyMode.NORMAL:
            return 1 << 0
        stopped = 1 << 10
        if self is SafetyMode.PROTECTIVE_STOP:
            return 1 << 2 | stopped
        return 1 << 6 | 1 << 7 | stopped


class RuntimeState(IntEnum):
    """RTDE `runtime_state` of the program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4


@dataclass(frozen=True)
class Event:
    """Something that happened."""

    clock: float
    """s of the controller's own clock."""
    monotonic_ns: int
    """The computer's CLOCK_MONOTONIC, ns."""
    text: str
