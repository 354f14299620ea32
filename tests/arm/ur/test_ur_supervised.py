"""The driver in its own process, through the unmodified ur_rtde, against the stand-in: a shift, and what goes wrong."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from shifts import PATIENCE_S, Shift, wait_for, with_dashboard

from twin_node.arm.ur import DriverState
from twin_node.cell.ur_sim import ControllerParameters, StandInParameters, StandInProcess, Watchdog, free_loopback
from twin_node.robot import ur_model
from twin_node.scene import JointPath


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


def test_a_driver_that_is_told_to_end_stops_the_arm_first(shift: Shift) -> None:
    """As a service's manager tells all of its processes."""
    begun = shift.stand_in.status().clock
    assert shift.driver.pid is not None
    os.kill(shift.driver.pid, signal.SIGTERM)
    shift.until_state(DriverState.HALTED, "driver process")
    shift.until(lambda: shift.stand_in.status().event("program paused: watchdog", begun) is not None)
    at_zero = shift.stand_in.status().event("speed slider at zero", begun)
    paused = shift.stand_in.status().event("program paused: watchdog", begun)
    assert at_zero is not None and paused is not None and at_zero.clock < paused.clock


@pytest.mark.parametrize("name", ["SIGINT", "SIGQUIT", "SIGHUP", "SIGTSTP", "SIGTTIN"])
def test_a_driver_leaves_what_a_terminal_says_to_its_supervisor(shift: Shift, name: str) -> None:
    """It reaches all processes of the terminal. With Ctrl-Z both stood still, as the terminal was closed the driver was
    gone before the other could tell it to stop the arm: the slider stayed where it was."""
    pid = shift.driver.pid
    assert pid is not None
    os.kill(pid, signal.Signals[name])
    shift.reports.clear()
    shift.until(lambda: len(shift.reports) > 10)
    assert shift.driver.pid == pid
    assert {report.state for report in shift.reports} == {DriverState.READY}


def test_a_hanging_driver_is_replaced(shift: Shift) -> None:
    hanging = shift.driver.pid
    assert hanging is not None
    os.kill(hanging, signal.SIGSTOP)
    shift.until_state(DriverState.HALTED, "driver process silent for 0.5 s")
    assert shift.driver.pid != hanging
    assert shift.stand_in.status().runtime_state == "PAUSED"


def test_a_hanging_driver_is_replaced_while_somebody_hands_it_more_than_it_has_room_for(shift: Shift) -> None:
    hanging = shift.driver.pid
    assert hanging is not None
    names, count = ur_model("ur5e").joint_names, 100_000
    path = JointPath(names, np.arange(count, dtype=np.int64) * 1_000_000, np.zeros((count, 6)))
    taken: list[bool] = []
    sender = threading.Thread(target=lambda: taken.append(shift.driver.follow(path)), daemon=True)
    with shift.supervisor_held_up():  # reports wait for it, as on a busy computer: it reads them before it finds out
        begun = shift.stand_in.status().clock
        wait_for(lambda: shift.stand_in.status().clock > begun + 0.2, threading.Event())
        os.kill(hanging, signal.SIGSTOP)
        sender.start()
        wait_for(shift.driver._handing.locked, threading.Event())
    try:
        wait_for(lambda: shift.driver.pid not in (hanging, None), threading.Event())
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(hanging, signal.SIGKILL)
    sender.join(PATIENCE_S)
    assert taken == [False]
    shift.until_state(DriverState.HALTED, "driver process silent")


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
