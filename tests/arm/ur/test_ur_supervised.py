"""The driver in its own process, through the unmodified ur_rtde, against the stand-in: a shift, and what goes wrong.

Deadlines here are long enough for a busy computer; how fast the driver is, `twin_node bench ur` measures.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from twin_node.arm import LimiterParameters
from twin_node.arm.errors import ArmError
from twin_node.arm.ur import DriverMode, DriverReport, DriverState, SupervisedDriver, UrParameters
from twin_node.arm.ur.link import load_ur_rtde
from twin_node.cell.ur_sim import ControllerParameters, StandInParameters, StandInProcess, Watchdog, free_loopback
from twin_node.robot import RobotError, ur_model
from twin_node.scene import JointPath, Separation

dashboard_client = pytest.importorskip("dashboard_client", reason="ur_rtde is not installed (extra 'ur')")

PATIENCE_S = 60.0
CLEAR = Separation(0, 0, 1.0, 0, 0, 0, 0, 0, 0, "", -1, 1.0, "clear")


def parameters(host: str, **changes: object) -> UrParameters:
    unhurried = UrParameters(robot=host, stale_s=0.3, limiter=LimiterParameters(deadline_s=0.5, rise_per_s=5.0))
    return replace(unhurried, **changes)


class Shift:
    """A driver at work: forecasts come at 30 Hz from a thread, reports are kept."""

    def __init__(self, stand_in: StandInProcess, **changes: object) -> None:
        self.stand_in = stand_in
        self.reports: list[DriverReport] = []
        self.fraction = 1.0
        self.is_fed = True
        self._heard = threading.Condition()
        self._ended = threading.Event()
        self.driver = SupervisedDriver(parameters(stand_in.host, **changes), self._hear)
        self._feeder = threading.Thread(target=self._feed, daemon=True)
        self._feeder.start()

    def until(self, holds: Callable[[], bool]) -> None:
        """Wait for something; looks again at every report."""
        last = time.monotonic() + PATIENCE_S
        with self._heard:
            while not holds():
                self._heard.wait(0.05)
                if time.monotonic() > last:
                    pytest.fail(f"did not come true: {self.driver.latest} {self.stand_in.status()}")

    def until_state(self, state: DriverState, reason: str = "") -> None:
        self.until(lambda: self.driver.latest.state is state and reason in self.driver.latest.reason)

    def until_moving(self) -> None:
        """The arm is at work under a driver that is well."""
        self.until(lambda: self.driver.latest.state is DriverState.READY and self.speed > 0.1)

    @property
    def speed(self) -> float:
        """Fastest joint as the driver reports it, rad/s."""
        sample = self.driver.latest.sample
        return 0.0 if sample is None else float(np.abs(sample.qd).max())

    def go_on(self) -> None:
        """Somebody looks, acknowledges, and presses play."""
        self.until(lambda: self.driver.acknowledge() and self.driver.latest.state is DriverState.READY)
        self.play()

    def play(self) -> None:
        with_dashboard(self.stand_in.host, lambda dashboard: dashboard.play())

    def close(self) -> None:
        self._ended.set()
        self._feeder.join()
        self.driver.close()

    def _hear(self, report: DriverReport) -> None:
        with self._heard:
            self.reports.append(report)
            self._heard.notify_all()

    def _feed(self) -> None:
        while not self._ended.wait(1 / 30):
            if self.is_fed:
                now = time.monotonic_ns()
                told = replace(CLEAR, evidence_stamp=now - 30_000_000, speed_fraction=self.fraction)
                self.driver.decide(told)


def with_dashboard(host: str, do: Callable[[Any], object]) -> None:
    dashboard = dashboard_client.DashboardClient(host)
    dashboard.connect()
    do(dashboard)
    dashboard.disconnect()


@pytest.fixture(scope="module")
def stand_in() -> Iterator[StandInProcess]:
    program = ControllerParameters(unlock_delay_s=0.1, watchdog=Watchdog(min_frequency_hz=4.0))
    with StandInProcess(StandInParameters(host=free_loopback(), controller=program)) as running:
        yield running


@pytest.fixture(scope="module")
def module_shift(stand_in: StandInProcess) -> Iterator[Shift]:
    begun = Shift(stand_in)
    yield begun
    begun.close()


@pytest.fixture
def shift(module_shift: Shift) -> Shift:
    """The module's driver and stand-in, the arm moving at full speed."""
    shift = module_shift
    shift.is_fed, shift.fraction = True, 1.0
    shift.until(lambda: shift.driver.latest.state in (DriverState.READY, DriverState.HALTED))
    shift.go_on()
    shift.until_moving()
    shift.reports.clear()
    return shift


def test_the_life_of_a_shift(shift: Shift) -> None:
    status = shift.stand_in.status
    shift.fraction = 0.2
    shift.until(lambda: status().speed_slider == pytest.approx(0.2, abs=0.01))
    shift.fraction = 0.0
    shift.until(lambda: status().speed_slider == 0 and shift.speed < 0.01)
    assert status().runtime_state == "PLAYING"  # the program waits, the watchdog is fed
    shift.fraction = 1.0
    shift.until_moving()
    begun = status().clock
    shift.stand_in.switch("protective-stop")
    shift.until_state(DriverState.HALTED, "PROTECTIVE_STOP")
    shift.driver.acknowledge()
    shift.until(lambda: any("PROTECTIVE_STOP" in str(report.refusal) for report in shift.reports))
    shift.until(lambda: status().clock > begun + 0.3)
    with_dashboard(shift.stand_in.host, lambda dashboard: dashboard.unlockProtectiveStop())
    shift.until(lambda: status().safety_mode == "NORMAL")
    assert shift.driver.latest.state is DriverState.HALTED  # unlocked is not acknowledged
    shift.go_on()
    shift.until_moving()
    shift.stand_in.switch("drop")
    shift.until_state(DriverState.LOST)
    shift.until_state(DriverState.HALTED)
    shift.go_on()
    shift.until_moving()


FAULTS = [
    ("freeze", "controller silent for 3", "thaw"),
    ("cut", "controller silent for 3", "join"),
    ("nan", "not finite", "whole"),
    ("five", "controller sent", "whole"),
    ("slow 500", "controller silent for 3", "slow 1"),
]


@pytest.mark.parametrize(("fault", "reason", "end"), FAULTS)
def test_a_fault_halts_latched_with_its_reason_and_is_acknowledged_when_over(
    shift: Shift, fault: str, reason: str, end: str
) -> None:
    shift.stand_in.switch(fault)
    shift.until_state(DriverState.HALTED, reason)
    assert shift.driver.latest.speed_fraction == 0.0
    shift.stand_in.switch(end)
    shift.until(lambda: shift.stand_in.status().runtime_state == "PAUSED")
    paused = shift.stand_in.status()
    assert paused.event("program paused: watchdog") is not None
    assert shift.driver.latest.state is not DriverState.READY


def test_a_cut_cable_pauses_the_arm_by_its_own_watchdog(shift: Shift) -> None:
    begun = shift.stand_in.status().clock
    shift.stand_in.switch("cut")
    shift.until(lambda: shift.stand_in.status().runtime_state == "PAUSED")
    paused = shift.stand_in.status().event("program paused: watchdog: no update of input_int_register_20", begun)
    assert paused is not None
    shift.stand_in.switch("join")


def test_a_controller_that_restarts_is_found_again_and_waits_for_somebody(shift: Shift) -> None:
    shift.stand_in.switch("restart 0.3")
    shift.until_state(DriverState.LOST)
    shift.until_state(DriverState.HALTED)
    assert shift.stand_in.status().runtime_state == "STOPPED"


def test_a_killed_driver_is_replaced_the_arm_paused_meanwhile(shift: Shift) -> None:
    killed, begun = shift.driver.pid, shift.stand_in.status().clock
    assert killed is not None
    os.kill(killed, signal.SIGKILL)
    shift.until_state(DriverState.HALTED, "driver process ended by signal 9")
    assert shift.driver.pid not in (None, killed)
    shift.until(lambda: shift.stand_in.status().runtime_state == "PAUSED")
    assert shift.stand_in.status().event("program paused: watchdog", begun) is not None


def test_a_hanging_driver_is_replaced(shift: Shift) -> None:
    hanging = shift.driver.pid
    assert hanging is not None
    os.kill(hanging, signal.SIGSTOP)
    shift.until_state(DriverState.HALTED, "driver process silent")
    assert shift.driver.pid != hanging
    assert shift.stand_in.status().runtime_state == "PAUSED"


def test_missing_forecasts_slow_then_stop_the_arm_and_are_acknowledged(shift: Shift) -> None:
    begun = shift.stand_in.status().clock
    shift.is_fed = False
    shift.until_state(DriverState.HALTED, "stopped: no forecast for")
    fractions = [report.speed_fraction for report in shift.reports]
    assert fractions.index(0.2) < fractions.index(0.0)
    shift.until(lambda: shift.stand_in.status().event("program paused: watchdog", begun) is not None)
    at_zero = shift.stand_in.status().event("speed slider at zero", begun)
    paused = shift.stand_in.status().event("program paused: watchdog", begun)
    assert at_zero is not None
    assert paused is not None
    assert at_zero.clock < paused.clock  # the slider came first


def test_an_emergency_stop_is_named(shift: Shift) -> None:
    shift.stand_in.switch("e-stop")
    shift.until_state(DriverState.HALTED, "ROBOT_EMERGENCY_STOP")
    shift.stand_in.switch("e-stop-release")
    shift.until(lambda: shift.stand_in.status().safety_mode == "NORMAL")
    with_dashboard(shift.stand_in.host, lambda dashboard: (dashboard.powerOn(), dashboard.brakeRelease()))


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
    clear = Separation(0, 0, 1.0, 0, 0, 0, 0, 0, 0, "", -1, 1.0, "clear")
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


def wait_for(holds: Callable[[], bool], pause: threading.Event) -> None:
    if not any(holds() or pause.wait(0.02) for _ in range(round(PATIENCE_S / 0.02))):
        pytest.fail("did not come true")


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


def test_a_driver_that_may_plays_on_by_itself_when_forecasts_are_back(other: StandInProcess) -> None:
    shift = Shift(other, resumes=True, plays=True)
    shift.until_state(DriverState.READY)
    shift.play()
    shift.until_moving()
    other.switch("cut")
    shift.until(lambda: other.status().runtime_state == "PAUSED")
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


def test_what_cannot_be_driven_is_refused_before_a_process_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RobotError, match="ur3e"):
        SupervisedDriver(UrParameters(model="kuka"))
    monkeypatch.setitem(sys.modules, "rtde_io", None)
    with pytest.raises(ArmError, match="pip install ur-rtde"):
        load_ur_rtde()


def test_no_controller_is_reported_and_looked_for_again() -> None:
    host = free_loopback()
    heard: list[DriverReport] = []
    news = threading.Event()
    with SupervisedDriver(parameters(host), lambda report: (heard.append(report), news.set())):
        wait_for(lambda: sum("expected a UR controller on port 30004" in r.reason for r in heard) >= 2, news)
        with StandInProcess(StandInParameters(host=host)):
            wait_for(lambda: heard[-1].state is DriverState.READY, threading.Event())
