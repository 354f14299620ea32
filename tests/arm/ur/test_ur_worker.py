"""The loop of a driver's process, on a driver that is played."""

from __future__ import annotations

import multiprocessing
from multiprocessing.connection import Connection
from typing import Any

import pytest

from twin_node.arm import ArmError
from twin_node.arm.ur import Acknowledge, DriverReport, DriverState, LeavePath, Order, UrParameters, worker

PARAMETERS = UrParameters()
MS = 1_000_000


class PlayedDriver:
    """Stands in for `UrDriver`: brakes for some steps, and refuses to leave a path."""

    def __init__(self, brakes: int = 0) -> None:
        self.brakes = brakes
        self.stopped: list[str] = []
        self.ends_after = 100_000

    @property
    def is_braking(self) -> bool:
        return self.brakes > 0

    def order(self, order: Order, now: int) -> None:
        if isinstance(order, LeavePath):
            raise ArmError("no path is followed")

    def step(self, now: int) -> DriverReport:
        self.brakes -= 1
        self.ends_after -= 1
        return DriverReport(now, DriverState.READY, "clear", is_over=self.ends_after < 0)

    def stop(self, reason: str) -> bool:
        self.stopped.append(reason)
        return self.is_braking


def pipes() -> tuple[Connection, Connection]:
    """The supervisor's end, and the process's."""
    return multiprocessing.Pipe()


def looped(driver: Any, pipe: Connection) -> bool:
    return worker._loop(PARAMETERS, driver, pipe)


@pytest.mark.parametrize("orders", [(LeavePath(), Acknowledge()), (Acknowledge(), LeavePath())])
def test_an_order_that_is_refused_is_told_of_though_others_come_with_it(orders: tuple[Order, ...]) -> None:
    ours, theirs = pipes()
    driver = PlayedDriver()
    driver.ends_after = 3
    for order in orders:
        ours.send(order)
    assert looped(driver, theirs), "the connection was lost"
    assert ours.recv().refusal == "no path is followed"
    while not (last := ours.recv()).is_over:
        assert last.refusal is None


def test_the_loop_ends_with_its_supervisor() -> None:
    ours, theirs = pipes()
    ours.close()
    assert not looped(PlayedDriver(), theirs)


def test_a_supervisor_that_does_not_read_holds_up_no_driver() -> None:
    _, theirs = pipes()
    report = DriverReport(0, DriverState.READY, "x" * 10_000)
    said = [worker._say(theirs, report) for _ in range(1000)]
    assert said[0] and not said[-1]


def test_a_stop_is_told_at_once_and_all_else_now_and_then() -> None:
    def report(at_ms: int, fraction: float | None, state: DriverState = DriverState.READY) -> DriverReport:
        return DriverReport(at_ms * MS, state, "", fraction)

    def is_news(*reports: DriverReport) -> bool:
        return worker._is_news(*reports)

    said = report(0, 1.0)
    assert worker._is_news(said, None)
    assert not is_news(report(4, 0.5), said)
    assert is_news(report(4, 0.0), said)
    assert not is_news(report(8, 0.0), report(4, 0.0))
    assert is_news(report(20, 1.0), said)
    assert is_news(report(4, 1.0, DriverState.HALTED), said)


@pytest.mark.parametrize("brakes", [0, 5])
def test_an_arm_that_is_servoed_is_braked_before_its_driver_ends(brakes: int) -> None:
    driver: Any = PlayedDriver(brakes)
    worker._stop(PARAMETERS, driver)
    assert (driver.stopped, driver.brakes) == (["the driver ends"], 0)


def test_an_arm_that_never_stands_is_not_braked_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker, "BRAKING_S", 0.02)
    driver: Any = PlayedDriver(1_000_000)
    worker._stop(PARAMETERS, driver)
    assert driver.is_braking
