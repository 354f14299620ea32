"""One node in this process, on the network: what `twin_node record` and `twin_node play` are."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from twin_node.nodes.launch.kinds import find_factory
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import kind_of
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.node import Node
from twin_node.runtime.wire_bus import WireBus
from twin_node.runtime.zenoh_session import ZenohParameters, open_router
from twin_node.runtime.zenoh_wire import ZenohWire


@contextlib.contextmanager
def open_wire(parameters: ZenohParameters | None = None) -> Iterator[ZenohWire]:
    """This process's end of the network, with a router where there is none yet."""
    parameters = parameters or ZenohParameters()
    router = open_router(parameters)
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
) -> None:
    """Runs a node until it has finished, or until SIGINT or SIGTERM, through its whole lifecycle.

    `where`: what errors name. Raises what the node raises.
    """
    executor = Executor()
    with open_wire(zenoh) as wire:
        bus = WireBus(wire, executor, kind, kind_of)
        setup = Setup(kind, bus, SystemClock(), executor, {kind: parameters}, where, executor.stop, wire.endpoints)
        node: Node = find_factory(kind)(setup)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: executor.stop())
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
