"""A driver at work on a stand-in, as tests of several files need it.

Deadlines are long enough for a busy computer; how fast the driver is, `twin_node bench ur` measures.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from twin_node.arm import LimiterParameters
from twin_node.arm.ur import DriverReport, DriverState, SupervisedDriver, UrParameters
from twin_node.cell.ur_sim import StandInProcess
from twin_node.scene import Separation

dashboard_client = pytest.importorskip("dashboard_client", reason="ur_rtde is not installed (extra 'ur')")

PATIENCE_S = 60.0
CLEAR = Separation.without_pair(0, 0, 1.0, "clear")


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

    @contextmanager
    def supervisor_held_up(self) -> Iterator[None]:
        """While this lasts, the thread that hears reports is in the middle of one."""
        with self._heard:
            yield

    def play(self) -> None:
        """Somebody presses play, where nothing plays."""
        if self.stand_in.status().runtime_state != "PLAYING":
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


def wait_for(holds: Callable[[], bool], pause: threading.Event) -> None:
    if not any(holds() or pause.wait(0.02) for _ in range(round(PATIENCE_S / 0.02))):
        pytest.fail("did not come true")
