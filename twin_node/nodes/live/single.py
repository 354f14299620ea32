"""One node in this process, on the network: what `twin_node record`, `twin_node play` and `twin_node view` are."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from twin_node.messages import convert
from twin_node.nodes.launch.kinds import find_factory
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import CLOCK, kind_of, kind_of_own
from twin_node.runtime.clock import Clock, FollowedClock, SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.node import Node
from twin_node.runtime.parameters import Sections
from twin_node.runtime.wire import Encoded
from twin_node.runtime.wire_bus import WireBus
from twin_node.runtime.zenoh_session import ZenohParameters, open_client, open_router
from twin_node.runtime.zenoh_wire import ZenohWire


class _GraphTime:
    """The time of day until somebody publishes `/clock`, and what that says from then on."""

    def __init__(self, wire: ZenohWire, node: str) -> None:
        self._followed = FollowedClock()
        wire.subscribe(node, CLOCK, kind_of_own(CLOCK), self._set)

    def now(self) -> int:
        """ns."""
        return self._followed.now() or time.time_ns()

    def _set(self, message: Encoded) -> None:
        self._followed.set(convert.clock_from_message(message.decode()))


@contextlib.contextmanager
def open_wire(parameters: ZenohParameters | None = None) -> Iterator[ZenohWire]:
    """This process's end of the network, with a router where there is none yet.

    Raises `WireError` where neither one can be started nor one answers: whoever went on would be alone, and not know.
    """
    parameters = parameters or ZenohParameters()
    router = open_router(parameters)
    if router is None:
        open_client(parameters).close()
    try:
        wire = ZenohWire(parameters)
        try:
            yield wire
        finally:
            wire.close()
    finally:
        if router is not None:
            router.close()


def run_single(
    kind: str,
    parameters: Mapping[str, Any],
    where: str,
    when_active: Callable[[Any], None] | None = None,
    zenoh: ZenohParameters | None = None,
    others: Sections | None = None,
    follows_clock: bool = False,
) -> None:
    """Runs a node until it has finished, or until SIGINT or SIGTERM, through its whole lifecycle.

    `where`: what errors name; `others`: sections of other nodes that it looks at; `follows_clock`: its time is that of
    `/clock` where there is one. Raises what the node raises.
    """
    executor = Executor()
    for number in (signal.SIGINT, signal.SIGTERM):  # first: an interrupted set-up ends in order too
        signal.signal(number, lambda *_: executor.stop())
    with open_wire(zenoh) as wire:
        bus = WireBus(wire, executor, kind, kind_of)
        clock: Clock = _GraphTime(wire, kind) if follows_clock else SystemClock()
        sections = {**(others or {}), kind: parameters}
        setup = Setup(kind, bus, clock, executor, sections, where, executor.stop, wire.endpoints)
        node: Node = find_factory(kind)(setup)
        node.configure()
        node.activate()
        try:
            if when_active is not None:
                when_active(node)
            executor.spin()
        finally:
            node.deactivate()
            node.cleanup()
            bus.close()
