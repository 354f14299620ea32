"""The rig of `bench ur`: a controller stand-in, a twin with its driver, and who has seen what when."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from twin_node.arm.ur import DriverMode, DriverState, UrParameters
from twin_node.bench.errors import BenchError
from twin_node.bench.ur_twin import TwinNews, TwinOrder, run_twin
from twin_node.cell.errors import CellError
from twin_node.cell.ur_sim import ControllerParameters, StandInParameters, StandInProcess, free_loopback
from twin_node.cell.ur_sim.states import Event
from twin_node.cell.ur_sim.status import Status

_PREPARATION_S = 60.0
"""Longest that a busy computer may take to bring the arm to work."""
_LOOK_S = 0.01
_MOVING = 0.05
"""rad/s above which the arm is at work."""
_STOPS = ("speed slider at zero", "program paused: watchdog", "program stopped: watchdog")
"""Events of the stand-in by which its arm has been told to stop, or stopped by itself."""


@dataclass(frozen=True)
class Answer:
    """How a fault was answered."""

    stamp: int
    """CLOCK_MONOTONIC, ns."""
    reason: str


class UrRig:
    """Everything runs in processes of its own; usable as a context."""

    def __init__(self, mode: DriverMode = DriverMode.SLIDER) -> None:
        controller = ControllerParameters(unlock_delay_s=0.1)
        self.stand_in = StandInProcess(StandInParameters(host=free_loopback(), controller=controller))
        self._mode = mode
        self._start_twin()

    def __enter__(self) -> UrRig:
        return self

    def __exit__(self, *_: object) -> None:
        self._end_twin()
        self.stand_in.close()

    def prepare(self) -> None:
        """Bring the arm to work under a driver that is well, whatever happened before.

        Raises `BenchError` where that takes too long.
        """
        last = time.monotonic() + _PREPARATION_S
        while not self.is_at_work:
            if time.monotonic() > last:
                raise BenchError(f"the arm does not come to work within {_PREPARATION_S:g} s: {self._news[-1:]}")
            self._help()
            time.sleep(_LOOK_S)

    def driver_answer(self, injected: int, within_s: float) -> Answer | None:
        """The driver's first halt after an injection (ns)."""
        return self._first(lambda: self._halt_since(injected), within_s)

    def arm_answer(self, injected: int, within_s: float) -> Answer | None:
        """When the stand-in's arm was first told to stop, or paused by itself, after an injection (ns)."""
        return self._first(lambda: self._stop_since(injected), within_s)

    def refusal(self, asked: int, within_s: float) -> Answer | None:
        """When the driver first refused an order after a time (ns)."""
        return self._first(lambda: self._refusal_since(asked), within_s)

    def halted_again(self, injected: int, within_s: float) -> Answer | None:
        """The first halt that a new driver process reports after an injection (ns); it may have done so already."""
        dead = self._driver_before(injected)
        return self._first(lambda: self._halt_since(injected, other_than=dead), within_s)

    def reason(self, injected: int) -> str | None:
        """What the driver last said of a halt after an injection (ns); None: nothing."""
        halts = [
            news.reason for news in tuple(self._news) if news.stamp >= injected and news.state is DriverState.HALTED
        ]
        return halts[-1] if halts else None

    def is_latched(self) -> bool:
        """Whether the arm stands, and stays so: neither driver nor program went on by itself."""
        news = self._news[-1] if self._news else None
        is_halted = news is None or news.state is not DriverState.READY
        return is_halted or self._status().runtime_state != "PLAYING"

    def order(self, order: TwinOrder) -> None:
        """Tell the twin something."""
        with contextlib.suppress(OSError):  # a twin that was killed hears nothing
            self._pipe.send(order)

    def revive(self) -> None:
        """A new stand-in where one was killed."""
        self.stand_in = self.stand_in.revived()

    def signal_driver(self, number: signal.Signals) -> None:
        """Send a signal to the driver's process."""
        pid = self._driver_pid
        if pid is None:
            raise BenchError("the driver has no process")
        os.kill(pid, number)

    def signal_twin(self, number: signal.Signals) -> None:
        """Send a signal to the twin's process."""
        if self._twin.pid is not None:
            os.kill(self._twin.pid, number)

    def replace_twin(self) -> None:
        """End the twin, however it is, and start another."""
        self._end_twin()
        self._start_twin()

    @property
    def is_at_work(self) -> bool:
        """Whether the driver is well, by its last word, and the arm moves."""
        if not self._news or self._news[-1].state is not DriverState.READY:
            return False
        return self._mode is DriverMode.SERVO or self._news[-1].speed > _MOVING

    @property
    def _driver_pid(self) -> int | None:
        return self._driver_before(time.monotonic_ns())

    def _driver_before(self, stamp: int) -> int | None:
        """Process of the driver that was last told of before a time (ns)."""
        told = (news.driver_pid for news in reversed(tuple(self._news)) if news.stamp < stamp)
        return next((pid for pid in told if pid is not None), None)

    def _start_twin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        parameters = replace(UrParameters(robot=self.stand_in.host), mode=self._mode)
        self._twin = context.Process(target=run_twin, args=(parameters, theirs))  # it has children: no daemon
        self._twin.start()
        theirs.close()
        self._news: list[TwinNews] = []
        threading.Thread(target=self._listen, args=(self._pipe, self._news), daemon=True).start()

    def _end_twin(self) -> None:
        self._twin.kill()
        self._twin.join()

    @staticmethod
    def _listen(pipe: object, news: list[TwinNews]) -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                news.append(pipe.recv())  # type: ignore[attr-defined]

    def _help(self) -> None:
        """What an operator does: unlock, acknowledge, play."""
        state = self._news[-1].state if self._news else DriverState.CONNECTING
        status = self._status()
        if status.safety_mode != "NORMAL":
            self.stand_in.dashboard("unlock protective stop")
        elif state is DriverState.HALTED:
            self.order(TwinOrder.ACKNOWLEDGE)
        elif state is DriverState.READY and status.runtime_state != "PLAYING" and self._mode is DriverMode.SLIDER:
            self.stand_in.dashboard("play")

    def _status(self) -> Status:
        return self.stand_in.status()

    def _first(self, look: Callable[[], Answer | None], within_s: float) -> Answer | None:
        """What `look` finds first within a time."""
        last = time.monotonic() + within_s
        while time.monotonic() < last:
            found = look()
            if found is not None:
                return found
            time.sleep(_LOOK_S)
        return None

    def _halt_since(self, stamp: int, other_than: int | None = None) -> Answer | None:
        for news in tuple(self._news):
            is_meant = other_than is None or news.driver_pid not in (None, other_than)
            if news.stamp >= stamp and news.state is DriverState.HALTED and is_meant:
                return Answer(news.stamp, news.reason)
        return None

    def _refusal_since(self, stamp: int) -> Answer | None:
        for news in tuple(self._news):
            if news.stamp >= stamp and news.refusal is not None:
                return Answer(news.stamp, news.refusal)
        return None

    def _stop_since(self, stamp: int) -> Answer | None:
        try:
            events: tuple[Event, ...] = self._status().events
        except (CellError, OSError, ValueError):
            return None  # the stand-in itself was ended
        for event in events:
            if event.monotonic_ns >= stamp and event.text.startswith(_STOPS):
                return Answer(event.monotonic_ns, event.text)
        return None
