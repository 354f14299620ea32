"""Acknowledges a halt of the arm's driver of a live graph, and hears what becomes of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from twin_node.arm.ur import DriverState
from twin_node.messages import Message, convert, message_type
from twin_node.nodes.topics import ACKNOWLEDGE, DIAGNOSTICS, GraphError, kind_of
from twin_node.nodes.ur_driver import DRIVEN_ARM
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire import Wire
from twin_node.runtime.wire_bus import WireBus

PATIENCE_S = 3.0
"""A driver speaks once a second, and at once where its state changes."""


@dataclass(frozen=True)
class Told:
    """What a driver has said of its arm."""

    state: str
    reason: str
    refused: str | None
    """Why the last acknowledgement was none."""

    @property
    def is_halted(self) -> bool:
        """Whether it waits for an acknowledgement, or for what has to come before."""
        return self.state == DriverState.HALTED.value

    def __str__(self) -> str:
        return f"{self.state}: {self.reason}"


def acknowledge(wire: Wire) -> tuple[Told, Told]:
    """What the driver of the graph says before and after it is told that somebody has seen to its halt.

    Raises `GraphError` where none is heard.
    """
    executor = Executor()
    bus = WireBus(wire, executor, "acknowledge", kind_of)
    heard: list[Told] = []
    bus.subscribe(DIAGNOSTICS, lambda message: heard.extend(_told(message)))

    def listen(is_enough: Callable[[], bool]) -> None:
        until = time.monotonic() + PATIENCE_S
        while not is_enough() and (left_s := until - time.monotonic()) > 0:
            executor.step(left_s)

    bus.advertise(ACKNOWLEDGE)
    listen(lambda: bool(heard) and bus.is_heard(ACKNOWLEDGE))
    if not heard:
        raise GraphError(
            f"expected the driver of an arm on the graph of this machine, heard none within {PATIENCE_S:g} s; "
            "'twin_node doctor' says who is there (another ROS_DOMAIN_ID or --namespace?)"
        )
    before = heard[-1]
    if before.is_halted:
        bus.publish(ACKNOWLEDGE, message_type("std_msgs/msg/Empty")())
        listen(lambda: not heard[-1].is_halted)
    return before, heard[-1]


def _told(message: Message) -> list[Told]:
    of_arm = [found for found in convert.diagnostics_from_message(message) if found.name == DRIVEN_ARM]
    readings = [{reading.key: reading.value for reading in found.readings} for found in of_arm]
    return [
        Told(values.get("state", ""), found.message, values.get("refused"))
        for found, values in zip(of_arm, readings, strict=True)
    ]
