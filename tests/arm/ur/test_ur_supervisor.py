"""What a supervisor makes of what its drivers say and how they end; the processes are played."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_node.arm.ur import DriverReport, DriverState, Halt, SupervisedDriver, UrParameters, supervisor
from twin_node.robot import ur_model
from twin_node.scene import JointPath

LOOK_S = 0.05
PATH = JointPath(ur_model("ur5e").joint_names, np.zeros(1, np.int64), np.zeros((1, 6)))
SILENCE, DEATH = "silence", "death"
Says = DriverReport | str
"""What a process does next: says something, says nothing for a look's time, or dies."""


class Theatre:
    """Processes that follow a script each; the last one goes on in silence, and time passes in silence alone."""

    def __init__(self, *scripts: list[Says]) -> None:
        self.scripts = deque(scripts)
        self.now_s = 100.0
        self.made = 0
        self.played: list[Played] = []
        self.is_over = threading.Event()


class Played:
    """Stands in for `DriverProcess`."""

    def __init__(self, theatre: Theatre) -> None:
        self._theatre = theatre
        theatre.made += 1
        self.pid = 7
        self.begun_with: Halt | None = None
        self.orders: list[Any] = []
        self.hung: list[bool] = []

    def begin(self, halt: Halt | None) -> None:
        self.begun_with = halt
        self._script = deque(self._theatre.scripts.popleft())
        self._theatre.played.append(self)

    def give(self, order: Any) -> bool:
        self.orders.append(order)
        return True

    def hear(self, timeout_s: float) -> DriverReport | None:
        if not self._script:
            if not self._theatre.scripts:
                self._theatre.is_over.set()
            self._theatre.is_over.wait(LOOK_S)
            return None
        says = self._script.popleft()
        if says == DEATH:
            raise EOFError
        if isinstance(says, DriverReport):
            return says
        self._theatre.now_s += timeout_s
        return None

    def hang_up(self) -> None:
        """Nobody waits."""

    def end(self, hangs: bool = False) -> str:
        self.hung.append(hangs)
        return "driver process ended by signal 9"


def says(state: DriverState, **more: Any) -> DriverReport:
    return DriverReport(0, state, state.value, **more)


READY, LOST, CONNECTING = says(DriverState.READY), says(DriverState.LOST), says(DriverState.CONNECTING)


@pytest.fixture
def play(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Theatre, list[DriverReport]]]:
    """Plays scripts to their end; gives back the theatre and all reports."""

    def run(*scripts: list[Says]) -> tuple[Theatre, list[DriverReport]]:
        theatre = Theatre(*scripts)
        heard: list[DriverReport] = []
        time = SimpleNamespace(monotonic=lambda: theatre.now_s, monotonic_ns=lambda: round(theatre.now_s * 1e9))
        monkeypatch.setattr(supervisor, "time", time)
        monkeypatch.setattr(supervisor, "_RETRY_S", 0.0)
        monkeypatch.setattr(supervisor, "load_ur_rtde", lambda: None)
        monkeypatch.setattr(supervisor, "DriverProcess", lambda _: Played(theatre))
        with SupervisedDriver(UrParameters(), heard.append) as driver:
            assert theatre.is_over.wait(60.0)
            driver.follow(PATH)
        return theatre, heard

    return run


Play = Callable[..., tuple[Theatre, list[DriverReport]]]


@pytest.mark.parametrize("is_playing", [True, False])
def test_a_driver_that_dies_at_work_leaves_a_halt_to_all_that_follow(play: Play, is_playing: bool) -> None:
    """Also where its successor dies before it is connected. It interrupts a program only where one ran."""
    at_work = says(DriverState.READY, sample=SimpleNamespace(is_playing=is_playing))
    theatre, _ = play([at_work, DEATH], [LOST, DEATH], [READY])
    halts = [process.begun_with for process in theatre.played]
    expected = Halt("driver process ended by signal 9", interrupts=is_playing)
    assert halts == [None, expected, expected]


def test_one_process_waits_in_reserve_however_often_its_driver_reports(play: Play) -> None:
    theatre, _ = play([READY, READY, READY, DEATH], [READY, READY])
    assert (len(theatre.played), theatre.made) == (2, 3)


def test_a_driver_that_dies_halted_leaves_the_halt_that_it_had(play: Play) -> None:
    """A safety stop must not become one that may end by itself."""
    halt = Halt("safety mode PROTECTIVE_STOP", is_safety=True)
    theatre, _ = play([READY, says(DriverState.HALTED, halt=halt), DEATH], [READY])
    assert theatre.played[1].begun_with == halt


def test_a_halt_tells_when_the_arm_was_last_seen(play: Play) -> None:
    """However many drivers are sent off meanwhile that do not see it."""
    seen = says(DriverState.READY, sample=SimpleNamespace(is_playing=True), sample_stamp=7)
    theatre, _ = play([seen, DEATH], [LOST, DEATH], [READY])
    halts = [process.begun_with for process in theatre.played[1:]]
    assert [halt.seen for halt in halts if halt is not None] == [7, 7]


def test_an_acknowledged_halt_is_left_to_nobody(play: Play) -> None:
    halt = Halt("stopped: no forecast for 200 ms")
    over = says(DriverState.HALTED, halt=Halt("connection lost"), is_over=True)
    theatre, heard = play([says(DriverState.HALTED, halt=halt), READY, over], [READY])
    assert theatre.played[1].begun_with == Halt("connection lost")
    assert DriverState.LOST in {report.state for report in heard}


def test_a_halt_outlives_a_driver_that_dies_while_it_goes_on(play: Play) -> None:
    halt = Halt("safety mode PROTECTIVE_STOP", is_safety=True)
    theatre, _ = play([READY, says(DriverState.HALTED, halt=halt), CONNECTING, DEATH], [READY])
    assert theatre.played[1].begun_with == halt


@pytest.mark.parametrize(("first", "patience_s"), [(READY, 0.5), (LOST, 15.0), (CONNECTING, 15.0)])
def test_a_driver_that_says_nothing_for_long_is_ended_at_once(
    play: Play, first: DriverReport, patience_s: float
) -> None:
    """One that connects may take longer than one at work."""
    looks = round(patience_s / LOOK_S)
    theatre, heard = play([first, *[SILENCE] * (looks - 1), first, *[SILENCE] * (looks + 2)], [READY])
    assert theatre.now_s == pytest.approx(100 + 2 * patience_s, abs=3 * LOOK_S)
    assert f"driver process silent for {patience_s:g} s" in [report.reason for report in heard]
    assert [process.hung for process in theatre.played] == [[True], [False]]


@pytest.mark.parametrize(("last", "orders"), [(READY, 1), (says(DriverState.HALTED, halt=Halt("x")), 1), (LOST, 0)])
def test_only_a_driver_with_a_connection_is_handed_orders(play: Play, last: DriverReport, orders: int) -> None:
    theatre, _ = play([last])
    assert len(theatre.played[0].orders) == orders
