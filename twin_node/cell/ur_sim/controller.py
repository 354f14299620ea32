"""The controller: safety, program, speed and targets, one period after another on its own clock."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from twin_node.arm import CyclicPath, default_path
from twin_node.cell.errors import CellError
from twin_node.cell.ur_sim.motions import Hold, Motion, Target
from twin_node.cell.ur_sim.registers import Inputs, Outputs
from twin_node.cell.ur_sim.simulated_arm import SimulatedArm
from twin_node.cell.ur_sim.states import Event, RobotMode, RuntimeState, SafetyMode
from twin_node.cell.ur_sim.watchdogs import Watchdog, WatchdogAction, Watchdogs
from twin_node.robot import UR_NAMES, ArmModel, ur_model
from twin_node.scene import Float64

JOINTS = 6
"""Of which RTDE tells, and all arms of UR have."""
PERIOD_S = 0.002
"""The e-Series' control period: 500 Hz."""
_SLOWING_PER_S = 5.0
"""How fast the speed follows slider and pause: to rest in 0.2 s, which on the default cycle (1.05 rad/s) takes the
5 rad/s^2 that UR's MoveIt configuration plans with. UR publishes no figure."""
_SAFETY_SLOWING_PER_S = 20.0
"""The same under a protective stop: 50 ms, about the UR3's published stopping time at this speed. An emergency stop
ends the program, and the arm brakes as at any other end."""
_EVENTS_KEPT = 1000


@dataclass(frozen=True)
class ControllerParameters:
    """What stands at the start, and what the stand-in's own program does."""

    model: ArmModel = field(default_factory=lambda: ur_model("ur5e"))
    cycle: CyclicPath | None = None
    """What the own program repeats; None: the arm's default pick-and-place cycle."""
    watchdog: Watchdog = field(default_factory=Watchdog)
    """What the own program calls `rtde_set_watchdog` with."""
    unlock_delay_s: float = 5.0
    """A protective stop cannot be unlocked sooner (user manual)."""

    def __post_init__(self) -> None:
        """Raises `CellError` for an arm that no UR controller moves."""
        count = len(self.model.joint_names)
        if count != JOINTS:
            raise CellError(
                f"{self.model.name}: expected an arm of {JOINTS} joints, as RTDE tells of, found {count}; "
                f"choose one of {', '.join(UR_NAMES)}"
            )


class Program(Protocol):
    """What runs on the controller."""

    @property
    def name(self) -> str:
        """As `get loaded program` tells it."""

    def tick(self, controller: Controller) -> None:
        """One period of a program that plays."""


class Controller:
    """All of the stand-in that has no socket; everything happens in `tick`, or between two of them."""

    def __init__(self, parameters: ControllerParameters) -> None:
        self.parameters = parameters
        self.cycle = parameters.cycle or default_path(parameters.model)
        start = self.cycle.at(0)
        self.arm = SimulatedArm(parameters.model, start, PERIOD_S)
        self._periods = 0
        self.inputs = Inputs()
        self.outputs = Outputs(self.arm.tool_pose, self.inputs)
        self.watchdogs = Watchdogs()
        self.events: deque[Event] = deque(maxlen=_EVENTS_KEPT)
        self.robot_mode = RobotMode.RUNNING
        self.safety_mode = SafetyMode.NORMAL
        self.runtime_state = RuntimeState.STOPPED
        self.program: Program | None = None
        self.motion: Motion = Hold()
        self.target = Target(start, np.zeros(6))
        self.slider = 1.0
        self.scale = 0.0
        """Share of the programmed speed at which motions advance: it follows the slider within 0.2 s."""
        self._stopped_at = -math.inf
        self._tell()

    @property
    def clock(self) -> float:
        """The controller's own time since its start, s."""
        return self._periods * PERIOD_S

    def note(self, text: str) -> None:
        """Remember an event."""
        self.events.append(Event(self.clock, time.monotonic_ns(), text))

    def tick(self) -> None:
        """One period: inputs, watchdogs, program, motion, arm, outputs."""
        self._periods += 1
        if self.inputs.number("speed_slider_mask") != 0:
            self._slide(self.inputs.number("speed_slider_fraction"))
        if self.runtime_state is RuntimeState.PLAYING:
            self._obey(self.watchdogs.expired(self.inputs, self.clock))
        if self.runtime_state is RuntimeState.PLAYING and self.program is not None:
            self.program.tick(self)
        self._move()
        self._settle()
        self._tell()

    def play(self, program: Program) -> bool:
        """Begin a program, or go on with the one that is paused; False where one plays, or the arm may not move."""
        if self.runtime_state is RuntimeState.PLAYING or not self._may_move():
            return False
        if self.runtime_state in (RuntimeState.PAUSED, RuntimeState.PAUSING) and self.program is not None:
            self.watchdogs.rearm(self.clock)
            self.note("program resumed")
        else:
            self.watchdogs.clear()
            self.program = program
            self.motion = Hold()
            self.note(f"program started: {program.name}")
        self.runtime_state = RuntimeState.PLAYING
        return True

    def replace(self, program: Program) -> bool:
        """Begin a program in place of whatever runs, as one that comes by the script port does."""
        if self.program is not None:
            self.stop("another program came")
        return self.play(program)

    def pause(self, why: str) -> bool:
        """Let the program stand, to be gone on with; False where none plays."""
        if self.runtime_state is not RuntimeState.PLAYING:
            return False
        self.runtime_state = RuntimeState.PAUSING
        self.note(f"program paused: {why}")
        return True

    def stop(self, why: str) -> bool:
        """End the program; False where there is none."""
        if self.program is None:
            return False
        self.program = None
        self.watchdogs.clear()
        self.motion = Hold()
        self.runtime_state = RuntimeState.STOPPING
        self.note(f"program stopped: {why}")
        return True

    def protective_stop(self, why: str) -> None:
        """Stop the arm until somebody unlocks it; a program is paused."""
        if self.safety_mode is SafetyMode.NORMAL:
            self.safety_mode = SafetyMode.PROTECTIVE_STOP
            self._stopped_at = self.clock
            self.note(f"protective stop: {why}")
            self.pause("protective stop")

    def unlock(self) -> bool:
        """End a protective stop; False while it is too young."""
        if self.clock - self._stopped_at < self.parameters.unlock_delay_s:
            return False
        if self.safety_mode is SafetyMode.PROTECTIVE_STOP:
            self.safety_mode = SafetyMode.NORMAL
            self.note("protective stop unlocked")
        return True

    def emergency_stop(self) -> None:
        """The button is pressed: the program ends and power goes."""
        self.safety_mode = SafetyMode.ROBOT_EMERGENCY_STOP
        self.note("emergency stop")
        self.stop("emergency stop")
        self.robot_mode = RobotMode.POWER_OFF

    def release_emergency_stop(self) -> None:
        """The button is pulled; power stays off."""
        if self.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP:
            self.safety_mode = SafetyMode.NORMAL
            self.note("emergency stop released")

    def power(self, mode: RobotMode) -> bool:
        """Switch power on or off, or release the brakes; False where the order or the safety system forbids it."""
        if mode is RobotMode.POWER_OFF:
            self.stop("power off")
        elif self.safety_mode is not SafetyMode.NORMAL or self.robot_mode not in (mode, *_BEFORE[mode]):
            return False
        self.robot_mode = mode
        self.note(f"robot mode {mode.name}")
        return True

    def set_tcp(self, offset: Float64) -> None:
        """URScript `set_tcp`: [6] m and rotation vector in the flange's frame."""
        self.outputs.tcp_offset = offset

    def _may_move(self) -> bool:
        return self.safety_mode is SafetyMode.NORMAL and self.robot_mode is RobotMode.RUNNING

    def _slide(self, fraction: float) -> None:
        if not math.isfinite(fraction):
            self.stop(f"speed slider: expected a share from 0 to 1, found {fraction:g}")
            return
        fraction = min(max(fraction, 0.0), 1.0)
        if (fraction == 0) != (self.slider == 0):
            self.note("speed slider at zero" if fraction == 0 else "speed slider above zero")
        self.slider = fraction

    def _obey(self, watchdog: Watchdog | None) -> None:
        if watchdog is None:
            return
        silence = self.clock - self.inputs.written(watchdog.variable)
        heard = f"{silence * 1e3:.0f} ms" if math.isfinite(silence) else "ever"
        why = f"watchdog: no update of {watchdog.variable} for {heard}"
        if watchdog.action is WatchdogAction.PAUSE:
            self.pause(why)
        else:
            self.stop(why)

    def _move(self) -> None:
        """Targets and arm, one period on."""
        is_safe = self.safety_mode is SafetyMode.NORMAL
        wanted = self.slider if self.runtime_state is RuntimeState.PLAYING else 0.0
        step = (_SLOWING_PER_S if is_safe else _SAFETY_SLOWING_PER_S) * PERIOD_S
        self.scale += min(max(wanted - self.scale, -step), step)
        before = self.target
        held = self.program is not None and self.runtime_state is not RuntimeState.PLAYING
        motion = Hold() if held and not self.motion.can_be_slowed else self.motion
        self.target = motion.advance(before, PERIOD_S, self.scale)
        acceleration = (self.target.qd - before.qd) / PERIOD_S
        self.arm.step(self.target.q, self.target.qd, acceleration)
        self.outputs.target_qdd = acceleration

    def _settle(self) -> None:
        """Programs that were told to stop or pause have done so when the arm stands, and not where its path pauses."""
        if self.runtime_state not in (RuntimeState.STOPPING, RuntimeState.PAUSING):
            return
        goes_on = self.program is not None and self.motion.can_be_slowed and self.scale > 0
        if goes_on or not self.target.is_standing:
            return
        if self.runtime_state is RuntimeState.STOPPING:
            self.runtime_state = RuntimeState.STOPPED
            self.note("standing: program stopped")
        else:
            self.runtime_state = RuntimeState.PAUSED
            self.note("standing: program paused")

    def _tell(self) -> None:
        """Outputs as they are now."""
        outputs = self.outputs
        outputs.timestamp = self.clock
        outputs.target_q, outputs.target_qd = self.target.q, self.target.qd
        outputs.actual_q, outputs.actual_qd = self.arm.q, self.arm.qd
        outputs.target_speed_fraction = self.slider
        outputs.speed_scaling = min(self.scale / self.slider, 1.0) if self.slider > 0 else 1.0
        outputs.robot_mode, outputs.safety_mode = self.robot_mode, self.safety_mode
        outputs.safety_status = self.safety_mode
        outputs.safety_status_bits = self.safety_mode.status_bits
        outputs.runtime_state = self.runtime_state
        is_playing = self.runtime_state is RuntimeState.PLAYING
        is_powered = self.robot_mode in (RobotMode.IDLE, RobotMode.RUNNING)
        outputs.robot_status_bits = int(is_powered) | int(is_playing) << 1


_BEFORE = {
    RobotMode.IDLE: (RobotMode.POWER_OFF,),
    RobotMode.RUNNING: (RobotMode.IDLE,),
    RobotMode.POWER_OFF: (RobotMode.IDLE, RobotMode.RUNNING),
}
"""From where each mode can be reached."""
