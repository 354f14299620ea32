"""What the stand-in tells of itself on its admin port, as one line of JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields

from twin_node.cell.ur_sim.controller import Controller
from twin_node.cell.ur_sim.states import Event


@dataclass(frozen=True)
class Status:
    """The controller at one of its periods."""

    clock: float
    """s of its own clock."""
    runtime_state: str
    safety_mode: str
    robot_mode: str
    program: str | None
    """Name of the program that runs or is paused."""
    speed_slider: float
    speed_scale: float
    """Share of the programmed speed at which its motions advance; it follows the slider."""
    q: tuple[float, ...]
    """Measured angles, rad."""
    is_standing: bool
    """Whether no joint is meant to move."""
    events: tuple[Event, ...]
    """The last thousand, oldest first."""

    def event(self, text: str, after: float = 0.0) -> Event | None:
        """The first event that begins with a text, at or after a time of the controller's clock (s)."""
        return next((event for event in self.events if event.clock >= after and event.text.startswith(text)), None)


def status_of(controller: Controller) -> Status:
    """A controller's status now."""
    return Status(
        clock=controller.clock,
        runtime_state=controller.runtime_state.name,
        safety_mode=controller.safety_mode.name,
        robot_mode=controller.robot_mode.name,
        program=None if controller.program is None else controller.program.name,
        speed_slider=controller.slider,
        speed_scale=controller.scale,
        q=tuple(float(angle) for angle in controller.arm.q),
        is_standing=controller.target.is_standing,
        events=tuple(controller.events),
    )


def to_line(status: Status) -> str:
    """As one JSON object without line breaks."""
    return json.dumps(asdict(status))


def from_line(line: str) -> Status:
    """The status in a line that `to_line` made."""
    values = json.loads(line)
    known = {field.name: values[field.name] for field in fields(Status)}
    known["q"] = tuple(known["q"])
    known["events"] = tuple(Event(**event) for event in known["events"])
    return Status(**known)
