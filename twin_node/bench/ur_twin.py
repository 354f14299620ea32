"""The twin of `bench ur`: a process that decides 30 times a second and holds a supervised driver."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, replace
from enum import Enum
from multiprocessing.connection import Connection

import numpy as np

from twin_node.arm.ur import DriverReport, DriverState, SupervisedDriver, UrParameters
from twin_node.arm.ur.priority import ask_for_realtime
from twin_node.scene import JointPath, Separation

_RATE_HZ = 30.0
"""Decisions per second: a camera's rate."""
_EVIDENCE_AGE_NS = 33_000_000
"""Age of a decision's evidence, ns: one image."""
_PRIORITY = 5
"""What is measured is the driver, not how a busy computer delays decisions; below driver and stand-in."""
_GO = Separation.without_pair(0, 0, 1.0, "clear")


class TwinOrder(Enum):
    """What the bench tells the twin."""

    DECIDE = "decide"
    STARVE = "starve"
    """No more decisions."""
    ACKNOWLEDGE = "acknowledge"
    FOLLOW_FIVE = "follow five"
    """Servo mode: send a trajectory of five joints."""


@dataclass(frozen=True)
class TwinNews:
    """What the bench needs of a driver's report."""

    stamp: int
    """CLOCK_MONOTONIC, ns."""
    state: DriverState
    reason: str
    refusal: str | None
    driver_pid: int | None
    speed: float
    """Fastest joint, rad/s."""


def run_twin(parameters: UrParameters, pipe: Connection) -> None:
    """Target of the process; ends with its pipe."""

    def tell(report: DriverReport) -> None:
        speed = 0.0 if report.sample is None else float(np.abs(report.sample.qd).max())
        pipe.send(TwinNews(report.stamp, report.state, report.reason, report.refusal, driver.pid, speed))

    driver = SupervisedDriver(parameters, tell)
    ask_for_realtime(_PRIORITY)
    due, decides = time.monotonic(), True
    with contextlib.suppress(EOFError, OSError):  # the bench has gone
        while True:
            while pipe.poll(max(due - time.monotonic(), 0.0)):
                order: TwinOrder = pipe.recv()
                if order is TwinOrder.ACKNOWLEDGE:
                    driver.acknowledge()
                elif order is TwinOrder.FOLLOW_FIVE:
                    driver.follow(_five_joints(parameters, driver.latest))
                else:
                    decides = order is TwinOrder.DECIDE
            due = max(due + 1 / _RATE_HZ, time.monotonic())
            if decides:
                driver.decide(replace(_GO, evidence_stamp=time.monotonic_ns() - _EVIDENCE_AGE_NS))
    driver.close()


def _five_joints(parameters: UrParameters, report: DriverReport) -> JointPath:
    """A trajectory that lacks the last joint."""
    start = np.zeros(6) if report.sample is None else report.sample.target_q
    names = parameters.arm().joint_names[:-1]
    return JointPath(names, np.array([0, 1_000_000_000]), np.tile(start[:-1], (2, 1)))
