"""What the link makes of `ur_rtde`'s answers. Its interfaces are pretended here: a connection needs a controller."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fake_link import START

from twin_node.arm.errors import ArmError
from twin_node.arm.ur import DriverMode, UrParameters
from twin_node.arm.ur.link import RtdeLink


def link_of(mode: DriverMode = DriverMode.SLIDER, **interfaces: object) -> RtdeLink:
    link = RtdeLink.__new__(RtdeLink)
    link._parameters = UrParameters(robot="10.0.0.2", mode=mode, heartbeat_register=20)
    link._receive, link._io, link._control = (interfaces.get(name) for name in ("receive", "io", "control"))
    return link


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
    """A control script that runs, or does once it is sent again; or never does."""

    def __init__(self, runs: bool, starts: bool = True, watches: bool = True) -> None:
        self.runs, self._starts, self._watches = runs, starts, watches
        self.watched_hz: float | None = None

    def isProgramRunning(self) -> bool:
        return self.runs

    def reuploadScript(self) -> None:
        self.runs = self._starts

    def setWatchdog(self, hz: float) -> bool:
        self.watched_hz = hz
        return self._watches


@pytest.mark.parametrize("runs", [False, True])
def test_a_control_script_is_watched_before_the_arm_is_sent_anywhere(runs: bool) -> None:
    script = Script(runs)
    link_of(DriverMode.SERVO, control=script).prepare_servo()
    assert (script.runs, script.watched_hz) == (True, UrParameters().watchdog_hz)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        (Script(False, starts=False), "control script: it does not start; look at the pendant"),
        (Script(True, watches=False), "control script: its watchdog cannot be set"),
    ],
)
def test_a_script_that_nobody_would_stop_is_refused(
    script: Script, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin_node.arm.ur.link._SCRIPT_START_S", 0.0)
    with pytest.raises(ArmError, match=words):
        link_of(DriverMode.SERVO, control=script).prepare_servo()


def test_a_link_that_is_half_gone_is_closed_all_the_same() -> None:
    closed: list[str] = []
    link = link_of(
        receive=SimpleNamespace(disconnect=lambda: closed.append("receive")), io=SimpleNamespace(disconnect=gone)
    )
    link.close()
    assert closed == ["receive"]
