"""One node in this process, on the network: what `twin_node record`, `twin_node play` and `twin_node view` are."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from twin_node.messages import convert
from twin_node.nodes.launch.kinds import find_factory
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import CLOCK, GraphError, kind_of, kind_of_own
from twin_node.runtime.clock import Clock, FollowedClock, SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.lifecycle_services import STEPS, Transition, serve_lifecycle
from twin_node.runtime.names import full_name
from twin_node.runtime.neighbours import NodeNames
from twin_node.runtime.node import LifecycleState, Node
from twin_node.runtime.parameter_services import serve_parameters
from twin_node.runtime.parameter_values import Parameter
from twin_node.runtime.parameters import Sections
from twin_node.runtime.wire import Encoded, Wire
from twin_node.runtime.wire_bus import WireBus
from twin_node.runtime.zenoh_session import ZenohParameters, close_session, open_client, open_router
from twin_node.runtime.zenoh_wire import ZenohWire


class GraphTime:
    """The time of day until somebody publishes `/clock`, and what that says from then on.

    The wire's namespace may have a clock of its own, renamed (`/cell/clock`), which wins.
    """

    def __init__(self, wire: Wire, node: str) -> None:
        self._of_all, self._own = FollowedClock(), FollowedClock()
        own = full_name(CLOCK.strip("/"), wire.namespace)
        for topic, clock in {CLOCK: self._of_all, own: self._own}.items():
            wire.subscribe(node, topic, kind_of_own(CLOCK), partial(self._set, clock))

    def now(self) -> int:
        """ns."""
        return self._own.now() or self._of_all.now() or time.time_ns()

    @staticmethod
    def _set(clock: FollowedClock, message: Encoded) -> None:
        clock.set(convert.clock_from_message(message.decode()))


@dataclass(frozen=True)
class _Led:
    """A node that lives as long as its command: others can end it, and lead it through nothing else."""

    node: Node
    end: Callable[[], None]

    @property
    def lifecycle(self) -> LifecycleState:
        return self.node.state

    def change(self, transition: Transition, done: Callable[[bool], None]) -> None:
        done(True)
        self.end()


@contextlib.contextmanager
def open_wire(
    parameters: ZenohParameters | None = None, sole: str = "", namespace: str | None = None
) -> Iterator[ZenohWire]:
    """This process's end of the network, with a router where there is none yet.

    `sole`: a node of this process of which a graph may have but one; launches and others hear of it. `namespace`: in
    place of that of the parameters.

    Raises `WireError` for what is no namespace, and where neither a router can be started nor one answers: whoever went
    on would be alone, and not know. Raises `GraphError` where the sole node is alive already.
    """
    parameters = parameters or ZenohParameters()
    if namespace is not None:
        parameters = replace(parameters, namespace=namespace)
    router = open_router(parameters)
    if router is None:
        close_session(open_client(parameters))
    with contextlib.ExitStack() as stack:
        if router is not None:
            stack.callback(close_session, router)
        if sole:
            stack.enter_context(_claimed(parameters, sole))
        wire = ZenohWire(parameters)
        stack.callback(wire.close)
        yield wire


def _claimed(parameters: ZenohParameters, node: str) -> NodeNames:
    names = NodeNames(parameters, [node])
    if names.taken() is None:
        return names
    names.close()
    raise GraphError(
        f"node '{node}' is alive already in ROS domain {parameters.domain_id}; end that one, or give this one "
        "another --namespace, or another number as ROS_DOMAIN_ID"
    )


def serve(wire: ZenohWire, node: Node, parameters: Mapping[str, Parameter], end: Callable[[], None]) -> None:
    """Lets others ask about a command's own node, and end it: `end()` is called in a thread of the wire's."""
    serve_parameters(wire, node.name, parameters)
    shutdowns = [transition for transition, step in STEPS.items() if step.is_shutdown]
    serve_lifecycle(wire, node.name, _Led(node, end), shutdowns)


def run_single(
    kind: str,
    parameters: Mapping[str, Any],
    where: str,
    when_active: Callable[[Any], None] | None = None,
    zenoh: ZenohParameters | None = None,
    others: Sections | None = None,
    follows_clock: bool = False,
    namespace: str | None = None,
) -> None:
    """Runs a node until it has finished, or until SIGINT or SIGTERM, through its whole lifecycle.

    `where`: what errors name; `others`: sections of other nodes that it looks at; `follows_clock`: its time is that of
    `/clock` where there is one; `namespace`: its own, in place of that of `zenoh`. Raises what the node raises.
    """
    executor = Executor()
    for number in (signal.SIGINT, signal.SIGTERM):  # first: an interrupted set-up ends in order too
        signal.signal(number, lambda *_: executor.stop())
    with open_wire(zenoh, namespace=namespace) as wire:
        bus = WireBus(wire, executor, kind, kind_of)
        clock: Clock = GraphTime(wire, kind) if follows_clock else SystemClock()
        sections = {**(others or {}), kind: parameters}
        setup = Setup(kind, bus, clock, executor, sections, where, executor.stop, wire.endpoints)
        node: Node = find_factory(kind)(setup)
        node.configure()
        node.activate()
        serve(wire, node, setup.read(follows_clock), executor.stop)
        try:
            if when_active is not None:
                when_active(node)
            executor.spin()
        finally:
            node.deactivate()
            node.cleanup()
            bus.close()
