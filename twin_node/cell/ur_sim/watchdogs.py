"""`rtde_set_watchdog`: what a program wants done when an input variable is not written often enough."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from twin_node.cell.errors import CellError
from twin_node.cell.ur_sim.registers import Inputs
from twin_node.cell.ur_sim.rtde_types import INPUTS


class WatchdogAction(Enum):
    """What happens to the program."""

    IGNORE = "ignore"
    PAUSE = "pause"
    STOP = "stop"


@dataclass(frozen=True)
class Watchdog:
    """One call of `rtde_set_watchdog(variable, min_frequency, action)` (URScript manual)."""

    variable: str = "input_int_register_20"
    min_frequency_hz: float = 10.0
    """At least so many updates per second; 0 watches nothing."""
    action: WatchdogAction = WatchdogAction.PAUSE

    def __post_init__(self) -> None:
        """Raises `CellError` for a variable that is no RTDE input, and for a frequency that is none."""
        if self.variable not in INPUTS:
            raise CellError(
                f"watchdog: expected an RTDE input such as input_int_register_20, found {self.variable!r}; "
                "correct the name"
            )
        if not 0 <= self.min_frequency_hz <= 500:
            raise CellError(f"watchdog: expected 0 to 500 Hz, found {self.min_frequency_hz:g}; correct the frequency")


class Watchdogs:
    """The watchdogs of the running program; they end with it."""

    def __init__(self) -> None:
        self._watched: dict[str, Watchdog] = {}
        self._armed = 0.0

    def set(self, watchdog: Watchdog, clock: float) -> None:
        """Watch a variable from a time on (s); a second call for the same variable replaces the first."""
        self._watched[watchdog.variable] = watchdog
        self._armed = clock

    def rearm(self, clock: float) -> None:
        """Give clients a full period again: a program goes on after a pause."""
        self._armed = clock

    def clear(self) -> None:
        """The program has ended."""
        self._watched.clear()

    def expired(self, inputs: Inputs, clock: float) -> Watchdog | None:
        """A watchdog whose variable has not come for longer than its period at a time (s)."""
        for watchdog in self._watched.values():
            if watchdog.min_frequency_hz > 0 and watchdog.action is not WatchdogAction.IGNORE:
                since = max(inputs.written(watchdog.variable), self._armed)
                if clock - since > 1.0 / watchdog.min_frequency_hz:
                    return watchdog
        return None
