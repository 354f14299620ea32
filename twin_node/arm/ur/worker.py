"""The driver's process: connects, then steps and reports until its connection or its supervisor is gone."""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from types import FrameType

from twin_node.arm.errors import ArmError
from twin_node.arm.ur.driver import UrDriver
from twin_node.arm.ur.link import RtdeLink, load_ur_rtde
from twin_node.arm.ur.parameters import UrParameters
from twin_node.arm.ur.records import Begin, DriverReport, DriverState, Order
from twin_node.errors import TwinError

_REPORT_NS = 20_000_000
"""Between two reports when nothing changes, ns: the 50 Hz at which joint states are published."""

_RETRY_S = 0.5
"""Between two attempts to connect."""

BRAKING_S = 2.0
"""Longest that a driver that ends brakes its arm, s: from 6.3 rad/s at 5 rad/s^2, behind the longest look-ahead."""

_OF_TERMINALS = (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)
"""What a terminal sends to the whole group. Where the supervisor ends, it ends us in order, or its pipe does; where
it is stopped (Ctrl-Z) no decisions come, and we stop the arm. Ended or stopped ourselves, we would leave the
slider where it was."""


class _Told(Exception):
    """Somebody wants the process to end."""


def work(parameters: UrParameters, pipe: Connection) -> None:
    """Target of the process: waits for `Begin`, then drives; the last report says why it ends."""
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # ur_rtde chats on what belongs to the command's own output
    for number in _OF_TERMINALS:
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _raise)
    try:
        load_ur_rtde()
        begin: Begin = pipe.recv()
        link = _connect(parameters, pipe)
        driver = UrDriver(parameters, link, time.monotonic_ns(), begin.halt)
    except TwinError as error:
        pipe.send(_lost(error, is_over=True))
    except (EOFError, OSError, _Told):
        os._exit(0)  # not needed any more
    else:
        is_lost = _loop(parameters, driver, pipe)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if not is_lost:
            _stop(parameters, driver)
            link.close()
    os._exit(0)  # threads of ur_rtde that still wait for a silent controller must not keep the process


def _connect(parameters: UrParameters, pipe: Connection) -> RtdeLink:
    """A connection, tried for until it stands where that is wanted; raises `ArmError` where it is not."""
    while True:
        try:
            return RtdeLink(parameters, lambda: pipe.send(_waiting()))
        except ArmError as error:
            if not parameters.reconnects:
                raise
            pipe.send(_lost(error, is_over=False))
        if pipe.poll(_RETRY_S):
            pipe.recv()  # an order that nobody can carry out; the end of the pipe raises


def _waiting() -> DriverReport:
    reason = "the control script begins"
    return DriverReport(time.monotonic_ns(), DriverState.CONNECTING, reason, speed_fraction=None)


def _lost(error: TwinError, is_over: bool) -> DriverReport:
    return DriverReport(time.monotonic_ns(), DriverState.LOST, str(error), speed_fraction=None, is_over=is_over)


def _loop(parameters: UrParameters, driver: UrDriver, pipe: Connection) -> bool:
    """Steps in time until the supervisor has gone (False) or the connection is lost (True); orders act at once."""
    period_ns = round(parameters.period_s * 1e9)
    orders = select.poll()  # made once: the pipe's own `poll` makes a selector with every call
    orders.register(pipe, select.POLLIN)
    due = time.monotonic_ns()
    said: DriverReport | None = None
    refusal: str | None = None
    try:
        while True:
            is_ordered = orders.poll(max(due - time.monotonic_ns(), 0) * 1e-6)  # it waits in ms
            while is_ordered:
                refusal = _obey(driver, pipe.recv()) or refusal
                is_ordered = orders.poll(0)
            now = time.monotonic_ns()
            if now >= due:
                due = max(due + period_ns, now)
            report = replace(driver.step(now), refusal=refusal)
            if report.is_over:
                pipe.send(report)  # the arm has been told what could be told: now there is time to wait
                return True
            if _is_news(report, said) and _say(pipe, report):
                said, refusal = report, None
    except (EOFError, OSError, _Told):
        return False  # the supervisor has gone, or says so: the caller stops the arm


def _stop(parameters: UrParameters, driver: UrDriver) -> None:
    """Let the arm stand; a servoed one is braked along its path first, for as long as whoever waits for it allows."""
    until = time.monotonic() + BRAKING_S
    is_braking = driver.stop("the driver ends")
    while is_braking and time.monotonic() < until:
        time.sleep(parameters.period_s)
        is_over = driver.step(time.monotonic_ns()).is_over
        is_braking = driver.is_braking and not is_over


def _is_news(report: DriverReport, said: DriverReport | None) -> bool:
    """Whether a report is worth saying: something has changed, or time has passed."""
    if said is None or report.refusal is not None or report.state is not said.state:
        return True
    is_stop = report.speed_fraction == 0 and said.speed_fraction != 0
    return is_stop or report.stamp - said.stamp >= _REPORT_NS


def _obey(driver: UrDriver, order: Order) -> str | None:
    """Carry out an order; gives back why not."""
    try:
        driver.order(order, time.monotonic_ns())
    except TwinError as error:
        return str(error)
    return None


def _say(pipe: Connection, report: DriverReport) -> bool:
    """Send a report unless the supervisor is too busy to read: a driver must not wait for it."""
    if not select.select([], [pipe], [], 0)[1]:
        return False
    pipe.send(report)
    return True


def _raise(_: int, __: FrameType | None) -> None:
    raise _Told
