"""Keeps a driver's process alive, hands it its orders, and remembers why the arm was halted."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from twin_node.arm.ur.link import load_ur_rtde
from twin_node.arm.ur.parameters import UrParameters
from twin_node.arm.ur.process import DriverProcess
from twin_node.arm.ur.records import Acknowledge, Decide, DriverReport, DriverState, Follow, Halt, LeavePath, Order
from twin_node.scene import JointPath, Separation

_LOOK_S = 0.05
"""How often the process is looked at when it says nothing."""
_HUNG_S = 0.5
"""A process that reported and then says nothing for so long hangs: a hundred of its periods."""
_CONNECTING_S = 15.0
"""Longest that connecting may take: `ur_rtde` waits up to 5 s for its script, and starts twice. A driver that says that
it is `CONNECTING` is in that again, its halt kept."""
_RETRY_S = 0.5
"""Before the next process where the last could not connect."""

_CONNECTED = (DriverState.READY, DriverState.HALTED)
_LOG = logging.getLogger(__name__)

OnReport = Callable[[DriverReport], None]


class SupervisedDriver:
    """A driver in a process of its own, made anew when it dies; a halt outlives it.

    One thread watches the process and calls `on_report`; every method may be called from any thread. A spare process
    waits with its libraries loaded, so that a new driver is at work within a few tenths of a second.
    """

    def __init__(self, parameters: UrParameters, on_report: OnReport | None = None) -> None:
        """Raises `RobotError` for an arm that is not known and `ArmError` without `ur_rtde`: no process starts then."""
        parameters.arm()
        load_ur_rtde()
        self._parameters = parameters
        self._on_report = on_report
        self._lock = threading.Lock()
        self._handing = threading.Lock()
        """One order after another. A process that hangs keeps who hands it a long one waiting, and nobody else."""
        self._latest = DriverReport(time.monotonic_ns(), DriverState.CONNECTING, "connecting", speed_fraction=None)
        self._process: DriverProcess | None = None
        self._spare: DriverProcess | None = None
        self._wants_spare = False
        self._closing = threading.Event()
        self._is_wanted = threading.Event()
        self._is_wanted.set()
        self._halt: Halt | None = None
        self._seen = 0
        """When the arm was last seen, ns; 0: never."""
        self._thread = threading.Thread(target=self._watch, name="ur_driver supervisor", daemon=True)
        self._thread.start()

    @property
    def latest(self) -> DriverReport:
        """The newest report."""
        with self._lock:
            return self._latest

    @property
    def pid(self) -> int | None:
        """Process id of the driver at work; None where there is none."""
        process = self._process
        return None if process is None else process.pid

    @property
    def halt(self) -> Halt | None:
        """What keeps the arm standing, or will when it is reached again; None: nothing does."""
        return self._halt

    def decide(self, separation: Separation) -> None:
        """Pass on a decision, whose evidence stamp is CLOCK_MONOTONIC, ns; without a connection it is forgotten."""
        self._give(Decide(separation))

    def follow(self, path: JointPath, came: int | None = None) -> bool:
        """Servo mode: follow a path now. False: there is no connection; reports say when it was refused.

        `came`: when it was asked for, CLOCK_MONOTONIC, ns; None: now. One that has waited is refused.
        """
        return self._give(Follow(path, time.monotonic_ns() if came is None else came))

    def leave_path(self) -> bool:
        """Servo mode: brake on the path that is followed, and stay there. False: there is no connection."""
        return self._give(LeavePath())

    def acknowledge(self) -> bool:
        """Somebody has looked: go on, if what was wrong is over. False: there is no connection."""
        return self._give(Acknowledge())

    def reconnect(self) -> None:
        """Connect again, where the driver does not do so by itself."""
        self._is_wanted.set()

    def close(self) -> None:
        """Stop the arm and end the process."""
        self._closing.set()
        self._is_wanted.set()
        self._thread.join()

    def __enter__(self) -> SupervisedDriver:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _give(self, order: Order) -> bool:
        with self._handing:
            process = self._process if self.latest.state in _CONNECTED else None
            return process is not None and process.give(order)

    def _watch(self) -> None:
        """One process after another, for as long as they are wanted."""
        while True:
            self._is_wanted.wait()
            if not self._parameters.reconnects:
                self._is_wanted.clear()  # before the look at `_closing`: `close` sets that first
            if self._closing.is_set():
                break
            was_connected = self._one_process()
            if not was_connected:
                self._closing.wait(_RETRY_S)
        if self._spare is not None:
            self._spare.end()

    def _one_process(self) -> bool:
        """Send a process off and listen to it until it ends; gives back whether it ever had a connection."""
        try:
            process = self._spare or DriverProcess(self._parameters)
        except OSError as error:  # the computer may have room for one later
            why = f"no driver process can be started ({error.strerror}); end what takes processes, files or memory"
            self._publish(DriverReport(time.monotonic_ns(), DriverState.LOST, why, speed_fraction=None))
            return False
        self._spare, self._wants_spare = None, True
        process.begin(self._halt)
        with self._handing:
            self._process = process
        reason = self._listen(process)
        process.hang_up()  # first: who hands it an order that it does not take is let go
        with self._handing:
            self._process = None
        how = process.end(hangs=not self._closing.is_set())
        was_connected = self._latest.state in _CONNECTED
        if self._latest.state is DriverState.READY:
            sample = self._latest.sample
            self._halt = Halt(reason or how, interrupts=sample is not None and sample.is_playing)
        if self._halt is not None and self._halt.seen is None and self._seen:
            self._halt = replace(self._halt, seen=self._seen)
        self._publish(DriverReport(time.monotonic_ns(), DriverState.LOST, reason or how, speed_fraction=None))
        return was_connected

    def _listen(self, process: DriverProcess) -> str | None:
        """Pass on reports until the process ends (None) or is to be ended: why."""
        heard = time.monotonic()
        patience_s = _CONNECTING_S
        while not self._closing.is_set():
            try:
                report = process.hear(_LOOK_S)
            except EOFError:
                return None
            if report is not None:
                heard = time.monotonic()
                patience_s = _HUNG_S if report.state in _CONNECTED else _CONNECTING_S
                self._take(report)
                if report.is_over:
                    return report.reason
            elif time.monotonic() - heard > patience_s:
                return f"driver process silent for {patience_s:g} s"
        return "closed"

    def _take(self, report: DriverReport) -> None:
        if report.state in _CONNECTED:
            self._halt = report.halt
        if report.sample is not None:
            self._seen = report.sample_stamp
        self._publish(report)
        if self._wants_spare and report.state in _CONNECTED:
            self._wants_spare = False
            with contextlib.suppress(OSError):  # it saves time and no more: the next process is started when needed
                self._spare = DriverProcess(self._parameters)

    def _publish(self, report: DriverReport) -> None:
        with self._lock:
            self._latest = report
        if self._on_report is None:
            return
        try:
            self._on_report(report)
        except Exception:  # whoever listens may fail: the arm stays supervised
            _LOG.exception("ur_driver: the listener to reports failed")
