"""Faults that can be switched on while the stand-in runs, by one line of text each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from twin_node.cell.errors import CellError
from twin_node.cell.ur_sim.rtde_types import INPUTS


@dataclass
class Faults:
    """What is wrong at the moment."""

    is_frozen: bool = False
    """The controller's program hangs: no period passes, nothing is read or answered, connections stay open."""
    is_cut: bool = False
    """The cable is out: the controller goes on, nothing reaches it or leaves it, connections stay open."""
    slowness: float = 1.0
    """Every period takes so many times as long."""
    sends_nan: bool = False
    """Measured joint angles and velocities are NaN."""
    sends_five_joints: bool = False
    """Packages hold five values where six measured angles and velocities belong."""

    @property
    def is_silent(self) -> bool:
        """Whether no byte may pass."""
        return self.is_frozen or self.is_cut


class Faulty(Protocol):
    """What a fault is done to: the stand-in."""

    faults: Faults

    def note(self, text: str) -> None:
        """Remember that it happened."""

    def refresh(self) -> None:
        """Let bytes pass, or not, as the faults now say."""

    def drop_connections(self) -> None:
        """Close every client's RTDE connection."""

    def restart(self, after_s: float) -> None:
        """End the controller with all its connections, and begin anew after a time."""

    def claim(self, variable: str) -> None:
        """Take an input variable as another client would."""

    def release(self, variable: str) -> None:
        """Give an input variable free that was claimed."""

    def protective_stop(self) -> None:
        """As if the arm had hit something."""

    def press_emergency_stop(self) -> None:
        """Press the button."""

    def release_emergency_stop(self) -> None:
        """Pull the button."""


@dataclass(frozen=True)
class _Switch:
    usage: str
    meaning: str
    act: Callable[[Faulty, str], None]
    read: Callable[[str], float | str] = str
    """The argument's value; raises `CellError` for a wrong one."""


def _set(**values: bool | float) -> Callable[[Faulty, str], None]:
    def act(target: Faulty, _: str) -> None:
        for name, value in values.items():
            setattr(target.faults, name, value)
        target.refresh()

    return act


def _slow(target: Faulty, argument: str) -> None:
    target.faults.slowness = _slowness(argument)


def _slowness(text: str) -> float:
    return _number("slow", text, 1.0, 1000.0)


def _away_s(text: str) -> float:
    return _number("restart", text, 0.0, 600.0)


def _input(text: str) -> str:
    if text not in INPUTS:
        raise CellError(f"fault: expected an RTDE input such as speed_slider_mask, found {text!r}; correct the name")
    return text


def _number(name: str, text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not low <= value <= high:
        raise CellError(f"fault {name}: expected a number from {low:g} to {high:g}, found {text!r}")
    return value


_SWITCHES = {
    "freeze": _Switch("freeze", "the controller hangs, connections stay open", _set(is_frozen=True)),
    "thaw": _Switch("thaw", "it goes on", _set(is_frozen=False)),
    "cut": _Switch("cut", "the cable is out: the arm goes on, no byte passes", _set(is_cut=True)),
    "join": _Switch("join", "the cable is back", _set(is_cut=False)),
    "slow": _Switch("slow N", "every control period takes N times as long; 1 is normal", _slow, _slowness),
    "nan": _Switch("nan", "measured joint values are NaN", _set(sends_nan=True)),
    "five": _Switch("five", "packages hold five measured joints", _set(sends_five_joints=True)),
    "whole": _Switch("whole", "joint values are right again", _set(sends_nan=False, sends_five_joints=False)),
    "drop": _Switch("drop", "RTDE connections are closed", lambda target, _: target.drop_connections()),
    "restart": _Switch(
        "restart S",
        "the controller ends and is back after S seconds, its program not running",
        lambda target, argument: target.restart(_away_s(argument)),
        _away_s,
    ),
    "claim": _Switch(
        "claim NAME", "an input variable is in use", lambda target, argument: target.claim(argument), _input
    ),
    "release": _Switch("release NAME", "it is free again", lambda target, argument: target.release(argument), _input),
    "protective-stop": _Switch("protective-stop", "as on contact", lambda target, _: target.protective_stop()),
    "e-stop": _Switch("e-stop", "the button is pressed", lambda target, _: target.press_emergency_stop()),
    "e-stop-release": _Switch("e-stop-release", "it is pulled", lambda target, _: target.release_emergency_stop()),
}


def check(line: str) -> None:
    """Raises `CellError` for a line that is no switch, lacks its argument or has a wrong one."""
    name, _, argument = line.strip().partition(" ")
    if name not in _SWITCHES:
        raise CellError(f"fault {name!r}: expected one of {', '.join(_SWITCHES)}; correct the name")
    takes_argument = " " in _SWITCHES[name].usage
    if takes_argument != bool(argument.strip()):
        raise CellError(f"fault {line.strip()!r}: expected '{_SWITCHES[name].usage}'; correct the argument")
    _SWITCHES[name].read(argument.strip())


def switch(target: Faulty, line: str) -> None:
    """Carry out a line such as `slow 10`; raises `CellError` as `check` does, and for what cannot be done just now."""
    check(line)
    name, _, argument = line.strip().partition(" ")
    _SWITCHES[name].act(target, argument.strip())
    target.note(f"fault: {line.strip()}")


def overview() -> str:
    """One line per switch, for the help."""
    return "\n".join(f"  {item.usage:16} {item.meaning}" for item in _SWITCHES.values())
