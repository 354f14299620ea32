"""The driver in its own process from its start to its end: whom it finds, refuses, waits for, and leaves standing."""

from __future__ import annotations

import errno
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from shifts import Shift, parameters, wait_for, with_dashboard

from twin_node.arm.errors import ArmError
from twin_node.arm.ur import DriverMode, DriverReport, DriverState, SupervisedDriver, UrParameters, link
from twin_node.arm.ur.link import load_ur_rtde
from twin_node.arm.ur.process import DriverProcess
from twin_node.cell.ur_sim import ControllerParameters, StandInParameters, StandInProcess, Watchdog, free_loopback
from twin_node.robot import RobotError, ur_model
from twin_node.scene import JointPath


def test_no_controller_is_reported_and_looked_for_again() -> None:
    host = free_loopback()
    heard: list[DriverReport] = []
    news = threading.Event()
    with SupervisedDriver(parameters(host), lambda report: (heard.append(report), news.set())):
        wait_for(lambda: sum("expected a UR controller on port 30004" in r.reason for r in heard) >= 2, news)
        with StandInProcess(StandInParameters(host=host)):
            wait_for(lambda: heard[-1].state is DriverState.READY, threading.Event())


def test_a_computer_without_room_for_a_process_is_told_and_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever drives must hear of it: a supervisor that had died of it would repeat its last word for ever."""
    asks: list[DriverProcess] = []
    start = DriverProcess.__init__

    def asked(process: DriverProcess, *arguments: Any) -> None:
        asks.append(process)
        if len(asks) in (1, 3):  # the first driver, and the spare of the second
            raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        start(process, *arguments)

    monkeypatch.setattr(DriverProcess, "__init__", asked)
    heard: list[DriverReport] = []
    pause = threading.Event()
    with (
        StandInProcess(StandInParameters(host=free_loopback())) as stand_in,
        SupervisedDriver(parameters(stand_in.host), heard.append),
    ):
        wait_for(lambda: len(asks) >= 3, pause)
        count = len(heard)
        wait_for(lambda: len(heard) > count and heard[-1].state is DriverState.READY, pause)
    assert heard[0].state is DriverState.LOST
    assert "no driver process can be started (Resource temporarily unavailable)" in heard[0].reason


@pytest.fixture(scope="module")
def module_other() -> Iterator[StandInProcess]:
    with StandInProcess(StandInParameters(host=free_loopback())) as running:
        yield running


@pytest.fixture
def other(module_other: StandInProcess) -> StandInProcess:
    """Another stand-in, begun anew."""
    module_other.switch("restart 0")
    wait_for(lambda: module_other.status().event("fault: restart") is None, threading.Event())
    return module_other


def test_closing_the_driver_stops_the_arm(other: StandInProcess) -> None:
    shift = Shift(other)
    shift.until_state(DriverState.READY)
    shift.play()
    shift.until_moving()
    shift.close()
    assert other.status().speed_slider == 0.0
    assert shift.driver.latest.state is DriverState.LOST


TWIN = """
import sys, time
from dataclasses import replace
from twin_node.arm.ur import SupervisedDriver, UrParameters
from twin_node.scene import Separation
if __name__ == "__main__":
    clear = Separation.without_pair(0, 0, 1.0, "clear")
    driver = SupervisedDriver(UrParameters(robot=sys.argv[1], stale_s=0.3))
    while True:
        driver.decide(replace(clear, evidence_stamp=time.monotonic_ns()))
        time.sleep(1 / 30)
"""


def test_when_the_twin_is_killed_its_driver_stops_the_arm_and_goes(other: StandInProcess) -> None:
    twin = subprocess.Popen([sys.executable, "-c", TWIN, other.host])
    pause = threading.Event()
    wait_for(lambda: other.status().event("speed slider above zero") is not None, pause)
    begun = other.status().clock
    twin.kill()
    twin.wait()
    wait_for(lambda: other.status().event("speed slider at zero", begun) is not None, pause)


def test_a_register_in_use_is_named_and_what_to_do(other: StandInProcess) -> None:
    other.switch("claim input_int_register_20")
    shift = Shift(other)
    shift.until_state(DriverState.LOST, "an input register that ur_rtde writes is in use")
    other.switch("release input_int_register_20")
    shift.until_state(DriverState.READY)
    shift.close()


def test_another_type_of_arm_is_refused(other: StandInProcess) -> None:
    shift = Shift(other, model="ur10e")
    shift.until_state(DriverState.LOST, "expected a ur10e, the controller says it has a UR5")
    shift.close()


@pytest.mark.parametrize(
    ("model", "told", "is_it"),
    [("ur7e", "UR7e", True), ("ur7e", "UR5", True), ("ur5e", "UR7e", False), ("ur12e", "UR5", False)],
)
def test_an_arm_that_carries_more_may_go_by_the_name_of_the_one_with_its_links(
    model: str, told: str, is_it: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody has told what controllers of a UR7e and a UR12e say; a UR5e's stopping data are not a UR7e's."""
    monkeypatch.setattr(link, "_check_reachable", lambda _: None)
    monkeypatch.setattr(link, "ask_dashboard", lambda _, order: told if order == "get robot model" else "")
    monkeypatch.setattr(link, "_module", MagicMock(side_effect=ArmError("went on")))
    with pytest.raises(ArmError, match="went on" if is_it else f"expected a {model}, the controller says"):
        link.RtdeLink(UrParameters(model=model))


def test_an_arm_of_airo_models_is_the_type_that_it_is_named_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "_check_reachable", lambda _: None)
    monkeypatch.setattr(link, "ask_dashboard", lambda _, order: "UR10")
    with pytest.raises(ArmError, match="expected a airo:ur5e, the controller says it has a UR10"):
        link.RtdeLink(UrParameters(model="airo:ur5e"))


@pytest.mark.parametrize(
    ("software", "model", "refusal"),
    [
        ("URSoftware 3.15.8.106339 (Nov 05 2021)", "ur5e", r"earlier series \(PolyScope 3\)"),
        ("URSoftware 3.15.8.106339 (Nov 05 2021)", "ur5_cb3.xml", "ur_rtde comes next"),
        ("URSoftware 5.12.6.1102099 (Sep 21 2022)", "ur5e", "ur_rtde comes next"),
        ("", "ur5e", "ur_rtde comes next"),
    ],
)
def test_an_arm_of_an_earlier_series_is_refused_unless_its_file_says_what_it_is(
    monkeypatch: pytest.MonkeyPatch, software: str, model: str, refusal: str
) -> None:
    """Its controller says "UR5" as a UR5e's does, and its tool is up to 10 cm from where a UR5e has it."""

    def no_module(_: str) -> Any:
        raise ArmError("ur_rtde comes next")

    monkeypatch.setattr(link, "_check_reachable", lambda _: None)
    monkeypatch.setattr(link, "ask_dashboard", lambda _, order: {"PolyscopeVersion": software}.get(order, "UR5"))
    monkeypatch.setattr(link, "_module", no_module)
    with pytest.raises(ArmError, match=refusal):
        link.RtdeLink(UrParameters(model=model))


def dashboard(said: bytes) -> tuple[str, threading.Thread]:
    """A dashboard's host that says so much and no more to whoever comes first."""
    host = free_loopback()
    server = socket.create_server((host, 29999))

    def serve() -> None:
        with server, server.accept()[0] as caller:
            caller.sendall(said)
            while caller.recv(100):
                pass

    serving = threading.Thread(target=serve, daemon=True)
    serving.start()
    return host, serving


@pytest.mark.parametrize(
    ("said", "answer"),
    [
        (b"Connected\nStarting program\n", "Starting program"),
        (b"Connected\nStarting pro", ""),
        (b"Connected\n", ""),
        (b"", ""),
    ],
)
def test_a_dashboard_is_waited_for_no_longer_than_whoever_waits_for_the_driver(said: bytes, answer: str) -> None:
    """It was for 0.3 s per word: a supervisor ended the driver that waited, whenever it had pressed play."""
    host, serving = dashboard(said)
    assert link.ask_dashboard(host, "play", 0.05 if answer == "" else 30.0) == answer
    serving.join()


@pytest.mark.parametrize(
    ("answer", "refused"),
    [("Starting program", ""), ("", ""), ("Failed to execute: play", "Failed"), (None, "reached")],
)
def test_a_dashboard_that_has_not_answered_yet_has_not_refused_to_play(
    monkeypatch: pytest.MonkeyPatch, answer: str | None, refused: str
) -> None:
    connected = object.__new__(link.RtdeLink)
    connected._parameters = UrParameters()
    monkeypatch.setattr(link, "ask_dashboard", lambda *_: answer)
    if not refused:
        connected.play()
        return
    with pytest.raises(ArmError, match=refused):
        connected.play()


def test_a_driver_that_may_plays_on_by_itself_when_forecasts_are_back(other: StandInProcess) -> None:
    shift = Shift(other, resumes=True, plays=True)
    shift.until_state(DriverState.READY)
    shift.play()
    shift.until_moving()
    other.switch("cut")
    shift.until(lambda: other.status().runtime_state == "PAUSED" and shift.driver.latest.state is not DriverState.READY)
    other.switch("join")
    shift.until_moving()
    shift.close()


def test_servo_mode_follows_slows_and_refuses(other: StandInProcess) -> None:
    shift = Shift(other, mode=DriverMode.SERVO, watchdog_hz=4.0)
    shift.until(lambda: shift.driver.latest.speed_fraction == 1.0)
    start = shift.driver.latest.sample
    assert start is not None
    s = np.linspace(0, 1, 101)
    way = (s**3 * (10 - 15 * s + 6 * s**2))[:, None] * np.array([0.4, 0, 0, 0, 0, 0])
    names = ur_model("ur5e").joint_names
    path = JointPath(names, (s * 1e9).astype(np.int64), start.target_q + way)
    shift.driver.follow(replace(path, names=names[:5], positions=path.positions[:, :5]))
    shift.until(lambda: any("wrist_3_joint" in str(report.refusal) for report in shift.reports))
    shift.driver.follow(replace(path, positions=path.positions * np.nan))
    shift.until(lambda: any("finite" in str(report.refusal) for report in shift.reports))
    assert other.status().q == pytest.approx(start.q, abs=1e-6)
    shift.driver.follow(path)
    shift.until(lambda: abs(other.status().q[0] - path.positions[-1, 0]) < 1e-3)
    shift.is_fed = False
    shift.until_state(DriverState.HALTED, "no forecast")
    shift.until(lambda: other.status().program is None)  # the script's own watchdog
    shift.is_fed = True
    shift.until(lambda: shift.driver.acknowledge() and shift.driver.latest.speed_fraction == 1.0)
    shift.close()


def test_another_program_is_left_alone_and_the_arm_where_it_has_led_it() -> None:
    """The goal that servoJ was last sent is still set then: the arm must not be servoed back to it."""
    unwatched = ControllerParameters(watchdog=Watchdog(min_frequency_hz=0.0))
    with StandInProcess(StandInParameters(host=free_loopback(), controller=unwatched)) as cell:
        shift = Shift(cell, mode=DriverMode.SERVO, watchdog_hz=4.0)
        shift.until(lambda: shift.driver.latest.speed_fraction == 1.0)
        shift.is_fed = False
        shift.until_state(DriverState.HALTED, "no forecast")
        shift.until(lambda: cell.status().program is None)
        start = np.array(cell.status().q)
        shift.play()
        shift.until(lambda: float(np.abs(np.array(cell.status().q) - start).max()) > 0.2)
        shift.is_fed = True
        shift.until(lambda: shift.driver.acknowledge() and "found one that runs" in str(shift.reports[-1].refusal))
        assert cell.status().program == "/programs/twin_cell.urp"
        with_dashboard(cell.host, lambda dashboard: dashboard.stop())
        shift.until(lambda: cell.status().runtime_state == "STOPPED")
        led_to = cell.status().q
        shift.until(lambda: shift.driver.acknowledge() and shift.driver.latest.speed_fraction == 1.0)
        assert cell.status().q == pytest.approx(led_to, abs=1e-3)
        shift.close()


@pytest.mark.parametrize("robot", ["192.168.1..10", "a" * 64, ".", "ur 5", ""])
def test_an_address_that_is_none_is_refused_before_a_socket_is_asked(robot: str) -> None:
    with pytest.raises(ArmError, match="expected an address or host name"):
        UrParameters(robot=robot)


@pytest.mark.parametrize("robot", ["192.168.1.10", "ur5e", "my-arm.lab.local.", "::1", "fe80::1"])
def test_addresses_and_names_of_hosts_are_taken(robot: str) -> None:
    assert UrParameters(robot=robot).robot == robot


def test_what_cannot_be_driven_is_refused_before_a_process_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RobotError, match="ur3e"):
        SupervisedDriver(UrParameters(model="kuka"))
    monkeypatch.setitem(sys.modules, "rtde_io", None)
    with pytest.raises(ArmError, match="pip install ur-rtde"):
        load_ur_rtde()
