"""The dashboard server: one line in, one line out (Universal Robots, "Dashboard Server e-Series")."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from twin_node.cell.ur_sim.connections import Connection, Served
from twin_node.cell.ur_sim.controller import Controller
from twin_node.cell.ur_sim.own_program import OwnProgram
from twin_node.cell.ur_sim.states import RobotMode, RuntimeState

if TYPE_CHECKING:
    import asyncio

_SERIAL_NUMBER = "20200000001"
"""Digits, as every controller's; no arm has it."""
_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)


class DashboardConnection(Connection):
    """One client of the dashboard."""

    def __init__(self, stand_in: Served) -> None:
        super().__init__(stand_in)
        self._text = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.send(b"Connected: Universal Robots Dashboard Server\n")

    def data_received(self, data: bytes) -> None:
        *lines, self._text = (self._text + data).split(b"\n")
        for line in lines:
            command = line.decode(errors="replace").strip()
            self.send(f"{answer(self.stand_in, command)}\n".encode())
            if command.lower() == "quit":
                self.close_after_writing()

    def close_after_writing(self) -> None:
        """End the connection when the last answer has gone."""
        if self._transport is not None:
            self._transport.close()


def answer(stand_in: Served, command: str) -> str:
    """Carry out a dashboard command and give back the server's answer."""
    told = _told(stand_in, command.lower())
    return _done(stand_in.controller, command) if told is None else told


def _told(stand_in: Served, command: str) -> str | None:
    """Answer to a question; None where it is none."""
    controller = stand_in.controller
    program = controller.program.name if controller.program is not None else OwnProgram.name
    is_running = controller.runtime_state is RuntimeState.PLAYING
    states = {RuntimeState.PLAYING: "PLAYING", RuntimeState.PAUSED: "PAUSED", RuntimeState.PAUSING: "PAUSED"}
    version = ".".join(str(part) for part in stand_in.version)
    answers = {
        "polyscopeversion": f"URSoftware {version}.0 (twin_node stand-in)",
        "get serial number": _SERIAL_NUMBER,
        "get robot model": controller.parameters.model.name.rstrip("e").upper(),
        "is in remote control": "true",
        "get operational mode": "NONE",
        "robotmode": f"Robotmode: {controller.robot_mode.name}",
        "safetymode": f"Safetymode: {controller.safety_mode.name}",
        "safetystatus": f"Safetystatus: {controller.safety_mode.name}",
        "running": f"Program running: {str(is_running).lower()}",
        "programstate": f"{states.get(controller.runtime_state, 'STOPPED')} {program.rpartition('/')[2]}",
        "get loaded program": f"Loaded program: {OwnProgram.name}",
        "isprogramsaved": f"true {program.rpartition('/')[2]}",
        "close popup": "closing popup",
        "close safety popup": "closing safety popup",
        "quit": "Disconnected",
    }
    return answers.get(command)


@dataclass(frozen=True)
class _Order:
    done: str
    failed: str
    carry_out: Callable[[Controller], bool]


_ORDERS = {
    "play": _Order("Starting program", "Failed to execute: play", lambda c: c.play(OwnProgram())),
    "pause": _Order("Pausing program", "Failed to execute: pause", lambda c: c.pause("dashboard")),
    "stop": _Order("Stopped", "Stopped", lambda c: c.stop("dashboard")),
    "unlock protective stop": _Order("Protective stop releasing", _TOO_EARLY, lambda c: c.unlock()),
    "power on": _Order("Powering on", "Failed to execute: power on", lambda c: c.power(RobotMode.IDLE)),
    "power off": _Order("Powering off", "Failed to execute: power off", lambda c: c.power(RobotMode.POWER_OFF)),
    "brake release": _Order(
        "Brake releasing", "Failed to execute: brake release", lambda c: c.power(RobotMode.RUNNING)
    ),
}


def _done(controller: Controller, command: str) -> str:
    """Answer to an order, which is carried out."""
    order = command.lower()
    if order in _ORDERS:
        known = _ORDERS[order]
        return known.done if known.carry_out(controller) else known.failed
    if order.startswith(("popup ", "addtolog ")):
        controller.note(command)
        return "showing popup" if order.startswith("popup") else "Added log message"
    if order.startswith("load "):
        name = command[len("load ") :].strip()
        is_own = name.rpartition("/")[2] == OwnProgram.name.rpartition("/")[2]
        return f"Loading program: {name}" if is_own else f"File not found: {name}"
    return f"could not understand: '{command}'"
