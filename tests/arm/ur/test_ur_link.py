"""What the link makes of `ur_rtde`'s answers. Its interfaces are pretended here: a connection needs a controller."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fake_link import START

from twin_node.arm.errors import ArmError
from twin_node.arm.ur import DriverMode, UrParameters
from twin_node.arm.ur.link import RtdeLink, ask_dashboard, load_ur_rtde


def link_of(mode: DriverMode = DriverMode.SLIDER, **interfaces: object) -> RtdeLink:
    link = RtdeLink.__new__(RtdeLink)
    link._parameters = UrParameters(robot="10.0.0.2", mode=mode, heartbeat_register=20)
    link._receive, link._io, link._control = (interfaces.get(name) for name in ("receive", "io", "control"))
    link._has_script, link._on_wait = link._control is not None, lambda: None
    return link


def receiving(runtime_state: object = 2) -> SimpleNamespace:
    """What tells of an arm in a runtime state, or in whatever one a function gives."""
    told = {name: [0.0] * 6 for name in ("ActualQ", "ActualQd", "TargetQ", "TargetQd")}
    told |= dict.fromkeys(("Timestamp", "TargetSpeedFraction", "SpeedScaling"), 1.0) | {"RobotMode": 7, "SafetyMode": 1}
    state = runtime_state if callable(runtime_state) else lambda: runtime_state
    getters = {f"get{name}": (lambda value=value: value) for name, value in told.items()}
    return SimpleNamespace(isConnected=lambda: True, getRuntimeState=state, **getters)


def test_every_field_of_a_state_is_what_the_controller_calls_so() -> None:
    joints = [np.arange(6.0) + 10 * group for group in range(4)]
    getters = ("ActualQ", "ActualQd", "TargetQ", "TargetQd")
    said = {f"get{name}": (lambda values=values: values.tolist()) for name, values in zip(getters, joints, strict=True)}
    numbers = {
        "Timestamp": 1.5,
        "RobotMode": 7,
        "SafetyMode": 1,
        "RuntimeState": 2,
        "TargetSpeedFraction": 0.4,
        "SpeedScaling": 0.9,
    }
    said |= {f"get{name}": (lambda value=value: value) for name, value in numbers.items()}
    found = link_of(receive=SimpleNamespace(isConnected=lambda: True, **said)).read()
    for values, expected in zip((found.q, found.qd, found.target_q, found.target_qd), joints, strict=True):
        np.testing.assert_array_equal(values, expected)
    assert (found.clock_s, found.robot_mode, found.safety_mode, found.runtime_state) == (1.5, 7, 1, 2)
    assert (found.speed_slider, found.speed_scaling) == (0.4, 0.9)


def test_a_lost_connection_tells_no_state() -> None:
    with pytest.raises(ArmError, match=r"10\.0\.0\.2: connection lost"):
        link_of(receive=SimpleNamespace(isConnected=lambda: False)).read()


def gone(*_: object) -> bool:
    raise RuntimeError("Broken pipe")


@pytest.mark.parametrize("write", [lambda *_: False, gone])
def test_what_was_not_written_is_not_taken_to_be(write: object) -> None:
    link = link_of(io=SimpleNamespace(setSpeedSlider=write, setInputIntRegister=write))
    with pytest.raises(ArmError, match=r"10\.0\.0\.2: writing failed"):
        link.set_speed(0.5)
    with pytest.raises(ArmError, match=r"10\.0\.0\.2: writing failed"):
        link.beat(3)


def test_slider_and_heartbeat_reach_the_controller() -> None:
    sent: list[object] = []
    io = SimpleNamespace(setSpeedSlider=lambda f: not sent.append(f), setInputIntRegister=lambda *a: not sent.append(a))
    link = link_of(io=io)
    link.set_speed(0.0)
    link.beat(3)
    assert sent == [0.0, (20, 3)]


@pytest.mark.parametrize("fraction", [-0.01, 1.01, np.nan])
def test_speeds_that_are_none_are_not_sent(fraction: float) -> None:
    with pytest.raises(ArmError, match="speed fraction: expected 0 to 1, found"):
        link_of(io=SimpleNamespace()).set_speed(fraction)


@pytest.mark.parametrize("q", [START[:5], np.where(np.arange(6) == 3, np.nan, START)])
def test_angles_that_are_none_are_not_sent(q: np.ndarray) -> None:
    with pytest.raises(ArmError, match="expected six finite angles"):
        link_of(DriverMode.SERVO, control=SimpleNamespace()).servo(q)


def test_angles_go_with_the_look_ahead() -> None:
    sent: list[tuple[float, ...]] = []
    link = link_of(DriverMode.SERVO, control=SimpleNamespace(servoJ=lambda q, *rest: bool(sent.append(rest)) or True))
    link._parameters = replace(link._parameters, lookahead_s=0.05)
    assert link.servo(START)
    assert sent == [(0.0, 0.0, 0.004, 0.05, 300.0)]


class Script:
    """A control interface whose script runs, and whose watchdog can be set; or not."""

    def __init__(self, runs: bool = True, watches: bool = True) -> None:
        self.runs, self._watches = runs, watches
        self.watched_hz: float | None = None
        self.is_disconnected = False

    def isConnected(self) -> bool:
        return True

    def isProgramRunning(self) -> bool:
        return self.runs

    def setWatchdog(self, hz: float) -> bool:
        self.watched_hz = hz
        return self._watches

    def disconnect(self) -> None:
        self.is_disconnected = True


Begins = Callable[[Script | RuntimeError], list[str]]


@pytest.fixture
def begins(monkeypatch: pytest.MonkeyPatch) -> Begins:
    """Pretends what a new control interface is; gives back the robots for which one is made."""

    def pretend(script: Script | RuntimeError) -> list[str]:
        made: list[str] = []

        def make(robot: str, _: float) -> Script:
            made.append(robot)
            if isinstance(script, RuntimeError):
                raise script
            return script

        monkeypatch.setattr("twin_node.arm.ur.link._module", lambda _: SimpleNamespace(RTDEControlInterface=make))
        monkeypatch.setattr("twin_node.arm.ur.link._SCRIPT_START_S", 0.0)
        return made

    return pretend


def test_a_control_script_that_runs_is_watched_before_the_arm_is_sent_anywhere() -> None:
    script = Script()
    link_of(DriverMode.SERVO, receive=receiving(), control=script).prepare_servo()
    assert script.watched_hz == UrParameters().watchdog_hz


@pytest.mark.parametrize("before", [None, Script(runs=False)])
def test_a_control_script_begins_by_a_new_interface(begins: Begins, before: Script | None) -> None:
    """One that is there already has its last goal still set: the arm may have been led elsewhere."""
    script, waits = Script(), []
    made = begins(script)
    states = iter([1, 2, 2])  # stopped, then begun
    link = link_of(DriverMode.SERVO, receive=receiving(lambda: next(states)), control=before)
    link._on_wait = lambda: waits.append(list(made))
    link.prepare_servo()
    assert (made, script.watched_hz) == (["10.0.0.2"], UrParameters().watchdog_hz)
    assert waits == [[]], "whoever waits is told first"
    assert before is None or before.is_disconnected


@pytest.mark.parametrize("state", [2, 4])
def test_another_program_is_neither_ended_nor_servoed(begins: Begins, state: int) -> None:
    """`ur_rtde` would end whatever runs or is paused: somebody may be at work with it."""
    made = begins(Script())
    link = link_of(DriverMode.SERVO, receive=receiving(state))
    with pytest.raises(ArmError, match="found one that runs or is paused; stop it on the pendant, then acknowledge"):
        link.prepare_servo()
    assert not link.servo(START)
    assert made == []


def test_a_script_in_whose_place_another_program_runs_is_not_sent_anything(begins: Begins) -> None:
    begins(Script())
    states = iter([1, 2, 2])  # the script was stopped; somebody plays another program
    link = link_of(DriverMode.SERVO, receive=receiving(lambda: next(states)), control=Script())
    link.read()
    link.read()
    assert not link.servo(START)
    with pytest.raises(ArmError, match="found one that runs"):
        link.prepare_servo()


def test_a_script_that_nobody_would_stop_is_refused() -> None:
    with pytest.raises(ArmError, match="control script: its watchdog cannot be set"):
        link_of(DriverMode.SERVO, receive=receiving(), control=Script(watches=False)).prepare_servo()


@pytest.mark.parametrize(
    "script", [Script(), RuntimeError("ur_rtde: Failed to start control script, before timeout of 5 seconds")]
)
def test_a_script_that_does_not_start_is_told_with_what_to_do(begins: Begins, script: Script | RuntimeError) -> None:
    begins(script)
    with pytest.raises(ArmError, match="control script: it does not start; look at the pendant"):
        link_of(DriverMode.SERVO, receive=receiving(1)).prepare_servo()


def test_a_paused_script_that_does_not_begin_anew_is_none_that_runs_here(begins: Begins) -> None:
    """The next acknowledgement asked the interface that had been given up: the driver's process ended in a trace."""
    begins(RuntimeError("ur_rtde: Failed to start control script, before timeout of 5 seconds"))
    link = link_of(DriverMode.SERVO, receive=receiving(4), control=Script(runs=False))
    with pytest.raises(ArmError, match="control script: it does not start; look at the pendant"):
        link.prepare_servo()
    assert not link.servo(START)
    with pytest.raises(ArmError, match="found one that runs or is paused; stop it on the pendant, then acknowledge"):
        link.prepare_servo()


def test_servo_mode_tells_a_controller_that_has_no_dashboard(begins: Begins) -> None:
    """PolyScope X: it was a connection that the controller had refused, by a timeout. Slider mode needs none."""
    begins(RuntimeError("Timeout connecting to UR dashboard server."))
    with pytest.raises(ArmError, match=r"servo mode needs the dashboard on port 29999.*PolyScope X.*in slider mode"):
        link_of(DriverMode.SERVO, receive=receiving(1)).prepare_servo()


def test_what_chats_on_the_dashboards_port_is_not_listened_to_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every word of it is in time for itself: the driver was kept from its arm for as long as they came."""
    words, now_s = iter([b"not a dashboard "] * 100), [0.0]

    class Chat:
        def __enter__(self) -> Chat:
            return self

        def __exit__(self, *_: object) -> None:
            """Nothing to close."""

        def sendall(self, _: bytes) -> None:
            """Whatever is asked."""

        def settimeout(self, seconds: float) -> None:
            assert seconds > 0

        def recv(self, _: int) -> bytes:
            now_s[0] += 0.01
            return next(words)

    monkeypatch.setattr("socket.create_connection", lambda *_, **__: Chat())
    monkeypatch.setattr("twin_node.arm.ur.link.time", SimpleNamespace(monotonic=lambda: now_s[0]))
    assert ask_dashboard("10.0.0.2", "play", 0.3) == ""
    assert now_s[0] == pytest.approx(0.3, abs=0.02)


def test_the_lost_connection_of_a_control_script_is_told() -> None:
    lost = SimpleNamespace(isConnected=lambda: False, servoJ=gone)
    link = link_of(DriverMode.SERVO, receive=receiving(), control=lost)
    with pytest.raises(ArmError, match=r"10\.0\.0\.2: writing failed \(Broken pipe\)"):
        link.servo(START)
    with pytest.raises(ArmError, match=r"10\.0\.0\.2: connection of the control script lost"):
        link.read()


def test_a_link_that_is_half_gone_is_closed_all_the_same() -> None:
    closed: list[str] = []
    link = link_of(
        receive=SimpleNamespace(disconnect=lambda: closed.append("receive")), io=SimpleNamespace(disconnect=gone)
    )
    link.close()
    assert closed == ["receive"]


@pytest.mark.parametrize(
    ("version", "machine", "words"),
    [
        ((3, 11, 2), "x86_64", "pip install ur-rtde"),
        ((3, 12, 3), "AMD64", "pip install ur-rtde"),
        ((3, 13, 5), "x86_64", r"this is 3\.13 on x86_64: .*speed_scaling"),
        ((3, 11, 2), "aarch64", r"this is 3\.11 on aarch64: .*speed_scaling"),
    ],
)
def test_who_has_no_ur_rtde_is_told_how_to_drive_the_arm(
    monkeypatch: pytest.MonkeyPatch, version: tuple[int, int, int], machine: str, words: str
) -> None:
    """Where there are no packages of it pip would try to build it, and fail."""
    monkeypatch.setitem(sys.modules, "rtde_receive", None)
    monkeypatch.setattr(sys, "version_info", version)
    monkeypatch.setattr("platform.machine", lambda: machine)
    with pytest.raises(ArmError, match=words):
        load_ur_rtde()
