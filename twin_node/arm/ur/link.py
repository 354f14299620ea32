"""The connection to a controller: what the driver needs of it, and the one that `ur_rtde` gives."""

from __future__ import annotations

import contextlib
import importlib
import platform
import re
import socket
import sys
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.errors import ArmError
from twin_node.arm.ur.parameters import DriverMode, UrParameters
from twin_node.arm.ur.sample import UrSample
from twin_node.robot import ur_shape
from twin_node.robot.arms import ur_name
from twin_node.scene import Float64

_VARIABLES = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "target_q",
    "target_qd",
    "robot_mode",
    "safety_mode",
    "safety_status_bits",
    "runtime_state",
    "target_speed_fraction",
    "speed_scaling",
)
"""Modes stand behind the joints: a package with too few joint values shows in them."""
_RTDE_PORT = 30004
_DASHBOARD_PORT = 29999
_DASHBOARD_S = 2.0
"""Longest that the dashboard may take in all."""
_PLAY_S = 0.3
"""The same while a supervisor waits for reports: half of what it waits."""
_REACH_TIMEOUT_S = 2.0
"""A controller in the same network answers within milliseconds; `ur_rtde` itself has no such limit."""
_GAIN = 300.0
"""servoJ's own default (URScript)."""

_NO_START = "control script: it does not start; look at the pendant, and switch to remote control"
_SCRIPT_START_S = 0.3
"""The state tells of a script that has begun within a few packages; the arm stands meanwhile."""


class UrLink(Protocol):
    """A connection to a controller. Methods raise `ArmError` when it is known to be lost."""

    def read(self) -> UrSample:
        """The state last received; it may be old."""

    def set_speed(self, fraction: float) -> None:
        """Move the speed slider, 0 to 1."""

    def beat(self, count: int) -> None:
        """Write the register that the robot's program watches."""

    def servo(self, q: NDArray[np.floating]) -> bool:
        """Send the next joint angles [6] (rad) of servoJ; False where the control script does not run.

        That they were sent says nothing of their arrival.
        """

    def prepare_servo(self) -> None:
        """Have the control script running with its watchdog set."""

    def play(self) -> None:
        """Let the robot's paused program go on."""

    def close(self) -> None:
        """Disconnect."""


class RtdeLink:
    """Receive, IO and control interface of `ur_rtde`, as far as the mode needs them.

    The control interface ends whatever program it finds on the robot, so it is made no sooner than the arm is to be
    servoed, and not where another program is there.
    """

    def __init__(self, parameters: UrParameters, on_wait: Callable[[], None] = lambda: None) -> None:
        """Connects; takes a tenth of a second. Raises `ArmError` where the controller cannot be reached or refuses.

        `on_wait()` is called before something that may take seconds.
        """
        self._parameters = parameters
        self._on_wait = on_wait
        self._io: Any = None
        self._control: Any = None
        self._has_script = False
        """Whether the program on the robot is the control script that was begun here."""
        _check_reachable(parameters.robot)
        _check_model(parameters.robot, parameters.model)
        try:
            self._receive = _module("rtde_receive").RTDEReceiveInterface(
                parameters.robot, parameters.receive_hz, list(_VARIABLES)
            )
            if parameters.mode is DriverMode.SLIDER:
                self._io = _module("rtde_io").RTDEIOInterface(parameters.robot)
        except RuntimeError as error:
            raise ArmError(_refused(parameters.robot, error)) from error

    def read(self) -> UrSample:
        """The state last received; raises `ArmError` where the link is known to be lost."""
        receive = self._receive
        if not receive.isConnected():
            raise ArmError(f"{self._parameters.robot}: connection lost")
        if self._control is not None and not self._control.isConnected():
            raise ArmError(f"{self._parameters.robot}: connection of the control script lost")
        sample = UrSample(
            clock_s=receive.getTimestamp(),
            q=_vector(receive.getActualQ()),
            qd=_vector(receive.getActualQd()),
            target_q=_vector(receive.getTargetQ()),
            target_qd=_vector(receive.getTargetQd()),
            robot_mode=receive.getRobotMode(),
            safety_mode=receive.getSafetyMode(),
            runtime_state=receive.getRuntimeState(),
            speed_slider=receive.getTargetSpeedFraction(),
            speed_scaling=receive.getSpeedScaling(),
        )
        self._has_script = self._has_script and not sample.has_ended
        return sample

    def set_speed(self, fraction: float) -> None:
        """Move the speed slider, 0 to 1; `ur_rtde` itself would send any number."""
        if not 0 <= fraction <= 1:
            raise ArmError(f"speed fraction: expected 0 to 1, found {fraction:g}")
        self._written(lambda: self._io.setSpeedSlider(fraction))

    def beat(self, count: int) -> None:
        """Write the register that the robot's program watches."""
        self._written(lambda: self._io.setInputIntRegister(self._parameters.heartbeat_register, count))

    def servo(self, q: NDArray[np.floating]) -> bool:
        """Send the next joint angles [6], rad; `ur_rtde` itself would send five. False where they were refused."""
        if q.shape != (6,) or not np.isfinite(q).all():
            raise ArmError(f"servo command: expected six finite angles, found {q.tolist()}")
        if not self._has_script:
            return False  # `ur_rtde` would wait for seconds for another program to take it
        period_s, lookahead_s = self._parameters.period_s, self._parameters.lookahead_s
        return bool(self._asked(lambda: self._control.servoJ(q.tolist(), 0.0, 0.0, period_s, lookahead_s, _GAIN)))

    def prepare_servo(self) -> None:
        """Have the control script running with its watchdog set; raises `ArmError` where it does not start.

        So it does while a program that is not the driver's runs or is paused: somebody may be at work with it.
        """
        if not self.read().has_ended and not self._has_script:
            raise ArmError(
                "control script: expected a robot without a program, found one that runs or is paused; stop it on the "
                "pendant, then acknowledge"
            )
        if not self._has_script or not self._asked(self._control.isProgramRunning):
            self._begin_script()
        if not self._asked(lambda: self._control.setWatchdog(self._parameters.watchdog_hz)):
            raise ArmError("control script: its watchdog cannot be set")

    def _begin_script(self) -> None:
        """Have the control script begin, by a new interface; until it has, nothing else can be done.

        One that is there already would begin it with its last command still set: an arm that was led elsewhere
        meanwhile would be servoed back at once.
        """
        self._on_wait()
        before, self._control, self._has_script = self._control, None, False
        try:
            if before is not None:
                before.disconnect()
            make = _module("rtde_control").RTDEControlInterface
            self._control = make(self._parameters.robot, self._parameters.receive_hz)
        except RuntimeError as error:
            raise ArmError(_refused(self._parameters.robot, error)) from error
        until = time.monotonic() + _SCRIPT_START_S
        while self.read().has_ended:
            if time.monotonic() >= until:
                raise ArmError(_NO_START)
            time.sleep(1 / self._parameters.receive_hz)
        self._has_script = True

    def play(self) -> None:
        """Let the robot's paused program go on; raises `ArmError` where the dashboard refuses.

        One that has not answered yet may be about to: whether the program plays, the controller's state tells.
        """
        answer = ask_dashboard(self._parameters.robot, "play", _PLAY_S)
        if answer not in ("Starting program", ""):
            raise ArmError(
                f"{self._parameters.robot}: the dashboard does not start the program ({answer or 'not reached'}); "
                "press play on the pendant, or switch to remote control"
            )

    def close(self) -> None:
        """Disconnect; a link that is lost already is no error."""
        for interface in (self._control, self._io, self._receive):
            if interface is not None:
                try:
                    interface.disconnect()
                except RuntimeError:
                    continue  # the other side has gone: nothing is left to be closed

    def _written(self, write: Callable[[], Any]) -> None:
        if not self._asked(write):
            raise ArmError(f"{self._parameters.robot}: writing failed")

    def _asked(self, ask: Callable[[], Any]) -> Any:
        """What `ur_rtde` answers; raises `ArmError` where it finds its connection lost."""
        try:
            return ask()
        except RuntimeError as error:
            raise ArmError(f"{self._parameters.robot}: writing failed ({error})") from error


def _vector(values: list[float]) -> Float64:
    return np.array(values, dtype=np.float64)


def _check_reachable(robot: str) -> None:
    try:
        socket.create_connection((robot, _RTDE_PORT), timeout=_REACH_TIMEOUT_S).close()
    except OSError as error:
        raise ArmError(
            f"{robot}: expected a UR controller on port {_RTDE_PORT} (RTDE), found none ({error.strerror or error}); "
            "check its address, the cable, and that RTDE is enabled in its security settings"
        ) from error


def _check_model(robot: str, model: str) -> None:
    """Raises `ArmError` where the controller says it has another type of arm; not every controller says."""
    name = ur_name(model)
    if name is None:
        return
    told = ask_dashboard(robot, "get robot model") or ""
    own = {same.rstrip("e").upper() for same in (name, ur_shape(name))}  # who carries more may go by the old name
    if re.fullmatch(r"UR\d+e?", told) and told.rstrip("e") not in own:
        raise ArmError(f"{robot}: expected a {model}, the controller says it has a {told}; choose that model")
    series = re.search(r"URSoftware ([123])\.", ask_dashboard(robot, "PolyscopeVersion") or "")
    if series:
        raise ArmError(
            f"{robot}: expected a {model}, found a controller of an earlier series (PolyScope {series[1]}), whose arms "
            "have links of other lengths; give the arm's MJCF or URDF file as the model, here and as 'arm.model'"
        )


def ask_dashboard(robot: str, order: str, longest_s: float = _DASHBOARD_S) -> str | None:
    """The dashboard's answer to one line; empty where there is none in time, None where nobody listens.

    PolyScope X has no dashboard.
    """
    until = time.monotonic() + longest_s
    try:
        connection = socket.create_connection((robot, _DASHBOARD_PORT), timeout=longest_s)
    except OSError:
        return None
    heard = b""
    with connection, contextlib.suppress(OSError):
        connection.sendall(f"{order}\n".encode())
        while heard.count(b"\n") < 2 and (left_s := until - time.monotonic()) > 0:  # the first line is its greeting
            connection.settimeout(left_s)
            more = connection.recv(4096)
            if not more:
                break
            heard += more
    _, *answers = heard.decode(errors="replace").split("\n")
    return answers[0].strip() if len(answers) > 1 else ""


def _refused(robot: str, error: RuntimeError) -> str:
    reason = " ".join(str(error).split())
    if "start control script" in reason:
        return _NO_START
    if "dashboard" in reason:
        return (
            f"{robot}: servo mode needs the dashboard on port {_DASHBOARD_PORT}, which does not answer; enable it in "
            "the controller's security settings, or, of PolyScope X, which has none, drive in slider mode"
        )
    if "in use" in reason:
        return (
            f"{robot}: an input register that ur_rtde writes is in use; end the other RTDE client, and switch off "
            "EtherNet/IP, PROFINET and MODBUS on the controller (of a connection that was cut it is free once the "
            "controller has given that up)"
        )
    return f"{robot}: the controller refused the connection: {reason}"


def load_ur_rtde() -> None:
    """Import what a connection will need, ahead of it; raises `ArmError` where `ur_rtde` is not installed."""
    for name in ("rtde_receive", "rtde_io", "rtde_control"):
        _module(name)


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ArmError(f"ur_rtde is not installed; {_how_to_get_it()}") from error


def _how_to_get_it() -> str:
    """As `pyproject.toml` says where there are packages of it."""
    machine = platform.machine()
    if sys.version_info < (3, 13) and machine.lower() in ("x86_64", "amd64"):
        return "install it with: pip install ur-rtde"
    version = ".".join(map(str, sys.version_info[:2]))
    return (
        f"its packages are for Python up to 3.12 on x86_64, and this is {version} on {machine}: drive the arm from "
        "such an environment (a launch can be joined from there), have ros2_control do it (node speed_scaling), or "
        "build ur_rtde from its source"
    )
