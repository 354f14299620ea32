"""How parts of the cell are doing: to `diagnostic_msgs` and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from twin_node.messages.stamps import header
from twin_node.messages.types import Message, MessageError, message_type


class Level(IntEnum):
    """Values as in `diagnostic_msgs/DiagnosticStatus`."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Reading:
    """A named value of a diagnosis, as text with its unit in the name."""

    key: str
    value: str


@dataclass(frozen=True)
class Diagnosis:
    """How one part is doing."""

    name: str
    """`node: part`, as diagnostic aggregators sort by."""
    level: Level
    message: str
    readings: tuple[Reading, ...] = ()
    hardware: str = ""
    """What it is about, where that is a device."""


def diagnostics_to_message(stamp: int, diagnoses: Sequence[Diagnosis]) -> Message:
    """`diagnostic_msgs/msg/DiagnosticArray` of diagnoses made at a stamp, ns."""
    value_of, status_of = (
        message_type("diagnostic_msgs/msg/KeyValue"),
        message_type("diagnostic_msgs/msg/DiagnosticStatus"),
    )
    return message_type("diagnostic_msgs/msg/DiagnosticArray")(
        header=header(stamp, ""),
        status=[
            status_of(
                level=int(diagnosis.level),
                name=diagnosis.name,
                message=diagnosis.message,
                hardware_id=diagnosis.hardware,
                values=[value_of(key=reading.key, value=reading.value) for reading in diagnosis.readings],
            )
            for diagnosis in diagnoses
        ],
    )


def diagnostics_from_message(message: Message) -> tuple[Diagnosis, ...]:
    """The diagnoses of a `diagnostic_msgs/msg/DiagnosticArray`. Raises `MessageError` for a level that is none."""
    for status in message.status:
        if status.level not in iter(Level):
            raise MessageError(
                f"diagnosis '{status.name}': expected a level from {Level.OK:d} to {Level.STALE:d}, found "
                f"{status.level}; the sender is at fault"
            )
    return tuple(
        Diagnosis(
            status.name,
            Level(status.level),
            status.message,
            tuple(Reading(value.key, value.value) for value in status.values),
            status.hardware_id,
        )
        for status in message.status
    )
