"""The program that `RTDEControlInterface` uploads, known by its commands in the registers alone."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

import numpy as np

from twin_node.cell.ur_sim.controller import PERIOD_S, Controller
from twin_node.cell.ur_sim.motions import Hold, Motion, MoveJ, ServoJ, SpeedJ
from twin_node.cell.ur_sim.simulated_arm import pose_in_base
from twin_node.cell.ur_sim.watchdogs import Watchdog, WatchdogAction
from twin_node.errors import TwinError
from twin_node.robot import forward_kinematics

_READY, _DONE = 1, 2
"""What the script answers in its first integer register."""
_STOP_SCRIPT = 255
_PROGRESS_SHIFT, _OPERATION_SHIFT = 16, 24
_RUNNING_BIT = 1 << 15
"""Layout of the third integer register: progress in per mille, running, number of writes, number of operations."""


class Command(IntEnum):
    """What a client may ask for in `input_int_register_0` (ur_rtde 1.6, `RobotCommand::Type`), as far as done here."""

    MOVEJ = 1
    ZERO_FT_SENSOR = 8
    SPEEDJ = 9
    SERVOJ = 11
    SPEED_STOP = 15
    SERVO_STOP = 16
    SET_PAYLOAD = 17
    GET_STEPTIME = 26
    SET_TCP = 29
    PROTECTIVE_STOP = 31
    STOPL = 33
    STOPJ = 34
    SET_WATCHDOG = 35
    IS_JOINTS_WITHIN_SAFETY_LIMITS = 37
    GET_TCP_OFFSET = 40
    GET_FORWARD_KINEMATICS = 43
    GET_FORWARD_KINEMATICS_ARGS = 44
    IS_STEADY = 47


_REALTIME = (6, Command.SPEEDJ, 10, Command.SERVOJ, 24, 25, Command.GET_STEPTIME, 27, 38, 58, 66, 67, 68, 69, 70, 71)
"""Commands that the script takes every period, without waiting for the client to clear the last one."""


class ControlScript:
    """Takes a command per period from the input registers and answers in the output registers, as the script does."""

    name = "rtde_control"

    def __init__(self) -> None:
        self._is_executing = False
        self._blocking: Motion | None = None
        self._asynchronous: Motion | None = None
        self._writes = 0
        self._operations = 0
        self._is_begun = False
        self._handlers: dict[int, Callable[[Controller], Motion | None]] = {
            Command.MOVEJ: self._move_j,
            Command.ZERO_FT_SENSOR: self._nothing,
            Command.SPEEDJ: self._speed_j,
            Command.SERVOJ: self._servo_j,
            Command.SPEED_STOP: self._brake,
            Command.SERVO_STOP: self._brake,
            Command.SET_PAYLOAD: self._nothing,
            Command.GET_STEPTIME: self._step_time,
            Command.SET_TCP: self._set_tcp,
            Command.PROTECTIVE_STOP: self._protective_stop,
            Command.STOPL: self._stop_move,
            Command.STOPJ: self._stop_move,
            Command.SET_WATCHDOG: self._set_watchdog,
            Command.IS_JOINTS_WITHIN_SAFETY_LIMITS: self._within_limits,
            Command.GET_TCP_OFFSET: self._tcp_offset,
            Command.GET_FORWARD_KINEMATICS: self._forward,
            Command.GET_FORWARD_KINEMATICS_ARGS: self._forward_of,
            Command.IS_STEADY: self._is_steady,
        }

    def tick(self, controller: Controller) -> None:
        """One period: finish what is under way, then look for the next command."""
        if not self._is_begun:
            self._is_begun = True
            self._tell_progress(controller, None)
            controller.outputs.int_registers[0] = _READY
        self._watch_asynchronous(controller)
        if self._blocking is not None:
            if self._blocking.is_done:
                self._blocking = None
                controller.outputs.int_registers[0] = _DONE
            return
        command = controller.inputs.integer(0)
        if command in _REALTIME:
            self._run(controller, command)
            controller.outputs.int_registers[0] = _READY
        elif command == 0:
            self._is_executing = False
            controller.outputs.int_registers[0] = _READY
        elif not self._is_executing:
            self._is_executing = True
            self._blocking = self._run(controller, command)
            if self._blocking is None:
                controller.outputs.int_registers[0] = _DONE

    def _run(self, controller: Controller, command: int) -> Motion | None:
        """Carry out a command; gives back what has to end before it counts as done."""
        if command == _STOP_SCRIPT:
            controller.stop("the client ended the script")
            return None
        handler = self._handlers.get(command)
        if handler is None:
            controller.stop(f"ur_rtde command {command} is not part of the stand-in")
            return None
        try:
            return handler(controller)
        except TwinError as error:  # what a client asked for is the end of its program, and not of the controller
            controller.stop(str(error))
            return None

    def _watch_asynchronous(self, controller: Controller) -> None:
        motion = self._asynchronous
        if motion is None:
            return
        if motion.is_done or controller.motion is not motion:
            self._asynchronous = None
            self._tell_progress(controller, None)
        elif isinstance(motion, MoveJ):
            self._tell_progress(controller, motion.progress)

    def _tell_progress(self, controller: Controller, progress: float | None) -> None:
        """Write the register of asynchronous operations; None: none is running."""
        self._writes = (self._writes + 1) % 128
        value = self._writes << _PROGRESS_SHIFT | self._operations << _OPERATION_SHIFT
        if progress is not None:
            value |= _RUNNING_BIT | round(progress * 1000)
        controller.outputs.int_registers[2] = value

    def _start(self, controller: Controller, motion: Motion) -> Motion | None:
        """Begin a motion that the client waits for, or not, as it asks in its second integer register."""
        controller.motion = motion
        if controller.inputs.integer(1) != 1:
            return motion
        self._asynchronous = motion
        self._operations = (self._operations + 1) % 128
        self._tell_progress(controller, 0.0)
        return None

    def _move_j(self, controller: Controller) -> Motion | None:
        goal = controller.inputs.vector(0)
        speed, acceleration = controller.inputs.double(6), controller.inputs.double(7)
        return self._start(controller, MoveJ(controller.target.q, goal, speed, acceleration))

    def _stop_move(self, controller: Controller) -> Motion | None:
        return self._start(controller, Hold(controller.inputs.double(0)))

    def _brake(self, controller: Controller) -> Motion | None:
        controller.motion = Hold(controller.inputs.double(0))
        return controller.motion

    def _speed_j(self, controller: Controller) -> None:
        controller.motion = SpeedJ(controller.inputs.vector(0), controller.inputs.double(6))

    def _servo_j(self, controller: Controller) -> None:
        lookahead_s = controller.inputs.double(9)
        velocities = controller.parameters.model.max_velocity
        controller.motion = ServoJ(controller.inputs.vector(0), lookahead_s, velocities)

    def _protective_stop(self, controller: Controller) -> None:
        controller.protective_stop("asked for by a client")

    def _set_watchdog(self, controller: Controller) -> None:
        frequency_hz = controller.inputs.double(0)
        watchdog = Watchdog("input_int_register_0", frequency_hz, WatchdogAction.STOP)
        controller.watchdogs.set(watchdog, controller.clock)

    def _set_tcp(self, controller: Controller) -> None:
        controller.set_tcp(controller.inputs.vector(0))

    def _tcp_offset(self, controller: Controller) -> None:
        controller.outputs.write_doubles(controller.outputs.tcp_offset)

    def _step_time(self, controller: Controller) -> None:
        controller.outputs.double_registers[0] = PERIOD_S

    def _is_steady(self, controller: Controller) -> None:
        controller.outputs.int_registers[1] = int(controller.target.is_standing)

    def _within_limits(self, controller: Controller) -> None:
        q, model = controller.inputs.vector(0), controller.parameters.model
        is_inside = bool(np.all((q >= model.lower) & (q <= model.upper)))
        controller.outputs.int_registers[1] = int(is_inside)

    def _forward(self, controller: Controller) -> None:
        controller.outputs.write_doubles(controller.outputs.actual_TCP_pose)

    def _forward_of(self, controller: Controller) -> None:
        model = controller.parameters.model
        pose = forward_kinematics(model, controller.inputs.vector(0))[-1]
        controller.outputs.write_doubles(pose_in_base(pose, controller.inputs.vector(6)))

    def _nothing(self, controller: Controller) -> None:
        """Accepted without effect: the stand-in weighs and measures nothing."""
