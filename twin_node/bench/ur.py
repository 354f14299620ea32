"""`twin_node bench ur`: how soon the arm is stopped after each fault, driver and controller stand-in as they are."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from twin_node.arm.ur import DriverMode
from twin_node.arm.ur.link import load_ur_rtde
from twin_node.arm.ur.priority import realtime
from twin_node.bench.errors import BenchError
from twin_node.bench.ur_rig import Answer, UrRig
from twin_node.bench.ur_twin import TwinOrder

TARGET_MS = 150.0
"""Every fault is to be answered within this, from its injection."""
RESTART_TARGET_MS = 2000.0
"""A killed driver is to be replaced within this."""
_WATCH_S = 3.0
"""How long an answer is waited for: beyond it the fault counts as unanswered."""
_RESTART_S = 30.0
"""Longest wait for a driver that was killed to be back."""
_PHASE_S = 0.05
"""Faults come at any phase of the driver's and the camera's periods."""
_LATCH_S = 0.3
"""How long after the end of a fault the arm must still stand."""

_PRIORITY = 4
"""Below everything that is measured."""


@dataclass(frozen=True)
class Fault:
    """One way in which driving an arm goes wrong."""

    name: str
    inject: Callable[[UrRig], None]
    end: Callable[[UrRig], None]
    answer: Callable[[UrRig, int, float], Answer | None]
    """Whose answer counts: the driver's halt, where the arm cannot be reached or stands by itself; else the arm's
    own: its slider at zero, or its program paused by the watchdog."""
    mode: DriverMode = DriverMode.SLIDER


def _switch(line: str) -> Callable[[UrRig], None]:
    return lambda rig: rig.stand_in.switch(line)


def _order(order: TwinOrder) -> Callable[[UrRig], None]:
    return lambda rig: rig.order(order)


def _nothing(_: UrRig) -> None:
    """The fault ends by itself."""


_BY_DRIVER, _BY_ARM = UrRig.driver_answer, UrRig.arm_answer

FAULTS = (
    Fault("controller_frozen", _switch("freeze"), _switch("thaw"), _BY_DRIVER),
    Fault("controller_killed", lambda rig: rig.stand_in.kill(), UrRig.revive, _BY_DRIVER),
    Fault("controller_restarted", _switch("restart 0.5"), _nothing, _BY_DRIVER),
    Fault("controller_slow", _switch("slow 100"), _switch("slow 1"), _BY_DRIVER),
    Fault("link_cut", _switch("cut"), _switch("join"), _BY_ARM),
    Fault("link_dropped", _switch("drop"), _nothing, _BY_DRIVER),
    Fault("joints_nan", _switch("nan"), _switch("whole"), _BY_ARM),
    Fault("joints_five", _switch("five"), _switch("whole"), _BY_ARM),
    Fault("protective_stop", _switch("protective-stop"), _nothing, _BY_DRIVER),
    Fault("driver_killed", lambda rig: rig.signal_driver(signal.SIGKILL), _nothing, _BY_ARM),
    Fault("driver_frozen", lambda rig: rig.signal_driver(signal.SIGSTOP), _nothing, _BY_ARM),
    Fault("twin_killed", lambda rig: rig.signal_twin(signal.SIGKILL), UrRig.replace_twin, _BY_ARM),
    Fault("twin_frozen", lambda rig: rig.signal_twin(signal.SIGSTOP), UrRig.replace_twin, _BY_ARM),
    Fault("forecast_stale", _order(TwinOrder.STARVE), _order(TwinOrder.DECIDE), _BY_ARM),
    Fault("trajectory_of_five", _order(TwinOrder.FOLLOW_FIVE), _nothing, UrRig.refusal, DriverMode.SERVO),
)
FAULT_NAMES = tuple(fault.name for fault in FAULTS)


@dataclass(frozen=True)
class Spread:
    """Figures of repeated measurements, ms."""

    p50_ms: float
    p99_ms: float
    max_ms: float
    repeats: int


@dataclass(frozen=True)
class FaultScore:
    """How one fault was answered."""

    answered: Spread | None
    """None: never."""
    unanswered: int
    not_latched: int
    """How often the arm went on by itself."""
    false_halts: int
    """How often it was halted before the fault came: by a busy computer."""
    reason: str
    """The last one given."""
    driver_back: Spread | None = None
    """Time until a new driver process had a connection; where the driver's process was ended."""
    not_back: int = 0
    """How often none had within `_RESTART_S`."""


@dataclass(frozen=True)
class UrBench:
    """The scores of all faults that were injected."""

    faults: dict[str, FaultScore]

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        worst = [score.answered.max_ms for score in self.faults.values() if score.answered is not None]
        return {
            "faults": {name: asdict(score) for name, score in self.faults.items()},
            "target_ms": TARGET_MS,
            "restart_target_ms": RESTART_TARGET_MS,
            "worst_ms": max(worst, default=None),
            "unanswered": sum(score.unanswered for score in self.faults.values()),
            "not_latched": sum(score.not_latched for score in self.faults.values()),
            "not_back": sum(score.not_back for score in self.faults.values()),
            "false_halts": sum(score.false_halts for score in self.faults.values()),
        }


def run(
    repeats: int = 20,
    names: Sequence[str] = FAULT_NAMES,
    progress: Callable[[Iterable[Fault]], Iterable[Fault]] = iter,
) -> UrBench:
    """Inject each fault so often, the arm at work; `progress` may wrap the faults.

    Raises `BenchError` for a fault that is not known, and `ArmError` without `ur_rtde`.
    """
    for name in names:
        if name not in FAULT_NAMES:
            raise BenchError(f"--fault {name}: expected one of {', '.join(FAULT_NAMES)}")
    load_ur_rtde()  # the drivers of all rigs are in other processes, and those would only be missed
    chosen = [fault for fault in FAULTS if fault.name in names]
    return UrBench({fault.name: _score(fault, repeats) for fault in progress(chosen)})


def _score(fault: Fault, repeats: int) -> FaultScore:
    """One fault, again and again on one rig."""
    answers: list[float] = []
    backs: list[float] = []
    reason, unanswered, not_latched, false_halts, not_back = "", 0, 0, 0, 0
    with realtime(_PRIORITY), UrRig(fault.mode) as rig:  # the time of an injection is taken, then it is made
        while len(answers) + unanswered < repeats:
            rig.prepare()
            time.sleep(random.uniform(0, _PHASE_S))
            if not rig.is_at_work:
                false_halts += 1
                continue
            injected = time.monotonic_ns()
            fault.inject(rig)
            answer = fault.answer(rig, injected, _WATCH_S)
            if fault.name.startswith("driver_"):
                back = rig.halted_again(injected, _RESTART_S)
                backs += [] if back is None else [(back.stamp - injected) * 1e-6]
                not_back += back is None
            answers += [] if answer is None else [(answer.stamp - injected) * 1e-6]
            unanswered += answer is None
            fault.end(rig)
            time.sleep(_LATCH_S)
            reason = rig.reason(injected) or (reason if answer is None else answer.reason)
            not_latched += fault.mode is DriverMode.SLIDER and not rig.is_latched()
    return FaultScore(_spread(answers), unanswered, not_latched, false_halts, reason, _spread(backs), not_back)


def _spread(samples: list[float]) -> Spread | None:
    if not samples:
        return None
    p50, p99 = np.percentile(samples, [50, 99])
    return Spread(round(float(p50), 1), round(float(p99), 1), round(max(samples), 1), len(samples))
