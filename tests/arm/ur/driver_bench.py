"""A driver with a controller and a clock that the test holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from fake_link import FakeLink, quintic

from twin_node.arm import LimiterParameters
from twin_node.arm.ur import (
    Acknowledge,
    Decide,
    DriverMode,
    DriverReport,
    DriverState,
    Follow,
    Halt,
    UrDriver,
    UrParameters,
)
from twin_node.scene import Separation

MS = 1_000_000
STEP_MS = 4
CLEAR = Separation.without_pair(0, 0, 1.0, "clear")


class Bench:
    """Driver, controller and clock; decisions come every 32 ms while `is_fed`."""

    def __init__(self, halt: Halt | None = None, **changes: object) -> None:
        self.link = FakeLink()
        parameters = UrParameters(**{"limiter": LimiterParameters(deadline_s=0.07, rise_per_s=100.0), **changes})
        self.now = 1000 * MS
        self.driver = UrDriver(parameters, self.link, self.now, halt)
        self.is_fed = True
        self.is_alive = True
        self.fraction = 1.0
        self.report: DriverReport

    def run(self, milliseconds: int) -> DriverReport:
        """Let time pass; gives back the last report."""
        for _ in range(0, milliseconds, STEP_MS):
            self.now += STEP_MS * MS
            if self.is_alive and self.now // MS % 8 == 0:
                self.link.tell(clock_s=self.now * 1e-9)
            if self.is_fed and self.now // MS % 32 == 0:
                evidence = self.now - 30 * MS
                self.driver.order(
                    Decide(replace(CLEAR, evidence_stamp=evidence, speed_fraction=self.fraction)), self.now
                )
            self.report = self.driver.step(self.now)
        return self.report

    def acknowledge(self) -> None:
        self.driver.order(Acknowledge(), self.now)

    def ms_until(self, state: DriverState, limit: int = 1000) -> int:
        """Milliseconds until a report has a state."""
        for passed in range(STEP_MS, limit, STEP_MS):
            if self.run(STEP_MS).state is state:
                return passed
        raise AssertionError(f"not {state} within {limit} ms, but {self.report}")


def servo_bench() -> Bench:
    bench = Bench(mode=DriverMode.SERVO)
    bench.run(200)
    bench.driver.order(Follow(quintic(), bench.now), bench.now)
    return bench


def steps_of(bench: Bench) -> np.ndarray:
    """Largest joint step between one servoJ command and the next, rad."""
    return np.abs(np.diff(np.array(bench.link.servoed), axis=0)).max(axis=1)
