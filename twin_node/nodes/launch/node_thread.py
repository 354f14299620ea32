"""The nodes of a process: a thread, an executor and a bus for each, all on one wire."""

from __future__ import annotations

import contextlib
import gc
import itertools
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from twin_node.errors import TwinError
from twin_node.messages import Message, builtin_types, convert
from twin_node.nodes.launch.kinds import SOURCES, find_factory
from twin_node.nodes.launch.order import Order
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import CLOCK, CLOCK_FOLLOWER, DIAGNOSTICS, ROSOUT, kind_of, kind_of_own
from twin_node.runtime.clock import Clock, FollowedClock, SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.late_wire import LateWire
from twin_node.runtime.lifecycle_services import STEPS, Transition, serve_lifecycle
from twin_node.runtime.names import full_name
from twin_node.runtime.node import LifecycleState, Node
from twin_node.runtime.parameter_services import serve_parameters
from twin_node.runtime.parameter_values import Parameter
from twin_node.runtime.parameters import fill
from twin_node.runtime.services import PATIENCE_S
from twin_node.runtime.wire import Encoded, Wire
from twin_node.runtime.wire_bus import Traffic, WireBus
from twin_node.runtime.zenoh_session import ZenohParameters

DIAGNOSTICS_PERIOD_S = 1.0
"""Diagnostics go out at 1 Hz, as is customary."""

LINES_KEPT = 100
"""Lines of a node that wait until it has joined the graph, or is done with what it does."""
PULSE_S = 1.0
"""How often a process tells its launcher that it does not hang, s."""
STUCK_S = 900.0
"""What a node has not done by then it never will, s: a first set may wait until a
device's code is compiled, which takes gsplat four minutes on two processors."""


class NodeFailedError(Exception):
    """A node that was active met what it could not work with: another try may go better."""


class NodeThread:
    """One node, made anew whenever time jumps: nothing that it knew is true then."""

    def __init__(
        self,
        name: str,
        order: Order,
        wire: Wire,
        clock: Clock,
        on_end: Callable[[], None],
        say: Callable[[str], None],
    ) -> None:
        """`on_end()` is called, in the node's thread, when it has finished or failed; `say(line)` tells the user."""
        self.name = name
        self.error: BaseException | None = None
        self.has_begun = False
        """Whether the node has been active: what fails then was not refused."""
        self._order = order
        self._wire = wire
        self._clock = clock
        self._on_end = on_end
        self._say = say
        self._executor = Executor()
        self._orders = self._executor.inbox(lambda do: do(), 16)
        self._changes = self._executor.inbox(lambda do: do(), 16, lifespan_s=PATIENCE_S)
        self._jumps = self._executor.inbox(lambda _: self._remake(), 1)
        """Of jumps in time that come while the node is busy, be it with the one before, the last is enough."""
        self._lines = self._executor.inbox(self._log, LINES_KEPT)
        self._bus: WireBus
        self._told: tuple[Traffic, ...] = ()
        """What was last said of the node's subscriptions."""
        self._node: Node | None = None
        self._is_deaf = False
        """Whether the node was led to be inactive while the graph goes on: it hears nothing till it begins anew."""
        self._parameters: dict[str, Parameter] = {}
        self._ends_since: float | None = None
        """When the node's end began, s of the monotonic clock."""
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def make(self) -> None:
        """Makes the node, in the calling thread; nobody hears of it yet. Raises what its factory raises."""
        self._bus = WireBus(self._wire, self._executor, self.name, kind_of, self._order.remaps)
        self._told = ()
        setup = Setup(
            self.name,
            self._bus,
            self._clock,
            self._executor,
            self._order.sections,
            self._order.where,
            self._finish,
            self._wire.endpoints,
            self._tell,
            Path(self._order.kept) if self._order.kept else None,
            lambda: self._executor.is_stopped,
            namespace=self._wire.namespace,
        )
        self._node = find_factory(self.name)(setup)
        self._is_deaf = False
        self._parameters.update(setup.read(self._order.follows_clock))

    def configure(self) -> None:
        """Configures the node, and makes it first where that was not done. Raises what the node raises."""
        if self._node is None:
            self.make()
        self._made.configure()
        self._executor.every(DIAGNOSTICS_PERIOD_S, self._diagnose)

    def start(self) -> None:
        """Lets the node's thread run; the node stays inactive. Others may ask about it, and lead it, from now on."""
        self._thread.start()
        serve_parameters(self._wire, self.name, self._parameters)
        serve_lifecycle(self._wire, self.name, self)

    def abandon(self) -> None:
        """Cleans up a node whose thread is not to be started, for another one was refused."""
        with contextlib.suppress(Exception):  # why the other was refused is what the user is to hear
            self._end_node()

    def activate(self) -> None:
        """Activates the node, in its thread."""
        self._orders.offer(self._activate)

    @property
    def lifecycle(self) -> LifecycleState:
        """Where the node is in its life; from any thread."""
        node = self._node  # once: it is taken away and made anew in its own thread
        return LifecycleState.UNCONFIGURED if node is None else node.state

    def change(self, transition: Transition, done: Callable[[bool], None]) -> None:
        """Leads the node through a transition, in its thread, and calls `done(whether it went)` there.

        Not at all where the node comes to it when nobody waits for the answer any more.
        """
        self._changes.offer(partial(self._change, transition, done))

    def begin_anew(self) -> None:
        """Replaces the node by a fresh one, in its thread."""
        self._jumps.offer(None)

    def stop(self, wait_s: float | None = None) -> bool:
        """Leads the node through deactivate and cleanup; gives back whether that is done, waits no longer than told."""
        self._executor.stop()
        if self._thread.ident is not None:
            self._thread.join(wait_s)
        return not self._thread.is_alive()

    @property
    def is_stuck(self) -> bool:
        """Whether the node is not done with one thing, be it its end, for so long that it never will be.

        From any thread.
        """
        since = self._ends_since
        return self._executor.busy_s > STUCK_S or (since is not None and time.monotonic() - since > STUCK_S)

    @property
    def _made(self) -> Node:
        assert self._node is not None, f"node '{self.name}' has not been made"
        return self._node

    def _activate(self) -> None:
        """Nothing where somebody has activated it, or cleaned it up, before the launch did."""
        if self.lifecycle is not LifecycleState.INACTIVE:
            return
        if self._is_deaf:
            self._forget()
            self._begin()
        self._made.activate()
        self.has_begun = True

    def _remake(self) -> None:
        if self._node is None or self._is_deaf:
            return  # it begins anew when it is activated
        is_active = self._made.state is LifecycleState.ACTIVE
        self._forget()
        self._begin()
        if is_active:
            self._made.activate()

    def _forget(self) -> None:
        """Ends the node and all that it had begun; there is none then."""
        self._end_node()
        self._executor.clear_timers()
        self._node = None

    def _begin(self) -> None:
        """Makes a fresh node, and configures it."""
        self.make()
        gc.collect()  # the node before and its bus hold each other, and this process looks for such rarely
        self.configure()

    def _end_node(self) -> None:
        if self._node is None:
            return
        if self._made.state is LifecycleState.ACTIVE:
            self._made.deactivate()
        if self._made.state is LifecycleState.INACTIVE:
            self._made.cleanup()
        self._bus.close()

    def _change(self, transition: Transition, done: Callable[[bool], None]) -> None:
        if STEPS[transition].start is not self.lifecycle:  # another transition was quicker
            done(False)
            return
        try:
            self._go(transition)
        except BaseException:
            done(False)
            raise
        self._tell(f"node {self.name} {STEPS[transition].done}, as somebody asked")
        done(True)

    def _go(self, transition: Transition) -> None:
        if transition is Transition.CONFIGURE:
            self._begin()
            self._rest()
        elif transition is Transition.CLEANUP:
            self._forget()
        elif transition is Transition.ACTIVATE:
            self._activate()
        elif transition is Transition.DEACTIVATE:
            self._made.deactivate()
            self._rest()
        else:
            self._finish()

    def _rest(self) -> None:
        """Leaves a node that is inactive nothing to do, for there are some that work on whatever they hear."""
        self._bus.close()
        self._executor.clear_timers()
        self._executor.every(DIAGNOSTICS_PERIOD_S, self._diagnose)
        self._is_deaf = True

    def _tell(self, line: str) -> None:
        """Tells the user a line, and whoever reads `/rosout`; from any thread."""
        self._say(line)
        self._lines.offer(line)

    def _log(self, line: str) -> None:
        logger = full_name(self.name, self._wire.namespace).removeprefix("/").replace("/", ".")  # as rclcpp names them
        self._bus.publish(ROSOUT, convert.line_to_log(self._clock.now(), logger, line))

    def _finish(self) -> None:
        self._executor.stop()

    def _run(self) -> None:
        for do in (self._executor.spin, self._end):
            try:
                do()
            except BaseException as error:  # the process's main thread raises it, whatever it is
                self.error = self.error or error  # the first: that its node cannot be ended either may come of it
        self._on_end()

    def _end(self) -> None:
        self._ends_since = time.monotonic()
        try:
            self._end_node()
        finally:
            self._ends_since = None

    def _diagnose(self) -> None:
        if self._is_deaf:
            told = f"inactive; 'twin_node lifecycle set /{self.name} activate' lets it begin anew"
            own: tuple[convert.Diagnosis, ...] = (
                convert.Diagnosis(f"{self.name}: lifecycle", convert.Level.WARN, told),
            )
        else:
            before, self._told = self._told, self._bus.traffic
            own = (_traffic_diagnosis(self.name, self._told, before), *self._made.diagnoses())
        self._bus.publish(DIAGNOSTICS, convert.diagnostics_to_message(self._clock.now(), own))


def _traffic_diagnosis(name: str, traffic: tuple[Traffic, ...], before: tuple[Traffic, ...]) -> convert.Diagnosis:
    """How the node's subscriptions are doing: what could not be used since `before`, and how much in all."""
    known = itertools.chain((t.unreadable for t in before), itertools.repeat(0))  # of all that there were by then
    bad = [t for t, count in zip(traffic, known, strict=False) if t.unreadable > count]
    message = "; ".join(f"{t.topic}: {t.last_error}" for t in bad) or "all messages taken"
    readings = tuple(
        convert.Reading(f"{what} {t.topic}", str(count))
        for t in traffic
        for what, count in (("dropped", t.dropped), ("unusable", t.unreadable))
        if count
    )
    return convert.Diagnosis(f"{name}: messages", convert.Level.WARN if bad else convert.Level.OK, message, readings)


class Graph:
    """All nodes of a process."""

    def __init__(self, order: Order, say: Callable[[str], None]) -> None:
        """`say(line)` tells the user."""
        self._wire = LateWire(fill(ZenohParameters, dict(order.zenoh), order.where))
        self._clock_topic = order.remaps.get(CLOCK, CLOCK)
        self._say = say
        self._clock: Clock = (
            FollowedClock(self._begin_anew) if order.follows_clock else SystemClock(self._on_clock_put_back)
        )
        self._ended = threading.Event()
        self._threads = [NodeThread(name, order, self._wire, self._clock, self._ended.set, say) for name in order.nodes]

    def make(self) -> None:
        """Makes every node, and loads all that they need; nothing is opened yet. Raises what a factory raises."""
        builtin_types()
        for thread in reversed(self._threads):
            thread.make()

    def configure(self) -> None:
        """Opens the wire and configures every node, the last first, so that nothing is missed of what the first say.

        Raises `WireError` where zenoh cannot be used, and what a node raises; the others are cleaned up then.
        """
        self._wire.open()
        if isinstance(self._clock, FollowedClock):
            self._wire.subscribe(
                CLOCK_FOLLOWER, self._clock_topic, kind_of_own(CLOCK), partial(_set_clock, self._clock)
            )
        configured: list[NodeThread] = []
        try:
            for thread in reversed(self._threads):
                thread.configure()
                configured.append(thread)
        except BaseException:
            for thread in configured:
                thread.abandon()
            raise
        for thread in self._threads:
            thread.start()

    def activate(self) -> None:
        """Activates every node, the last first; from any thread."""
        for thread in reversed(self._threads):
            thread.activate()

    def stop(self) -> None:
        """Let `run` return; from any thread."""
        self._ended.set()

    def run(self, pulse: Callable[[], None]) -> None:
        """Waits until told to stop, or a node has finished; raises what a node failed of.

        Meanwhile it calls `pulse()` once a second, for as long as none of the nodes hangs. What is raised is a
        `TwinError` only where the node has never been active; else a `NodeFailedError` of the same words.
        """
        goes_on = (self._ended.wait, *(thread.stop for thread in self._threads))  # a recording ends when it is on disk
        for is_over in goes_on:
            while not is_over(PULSE_S):
                if not any(thread.is_stuck for thread in self._threads):
                    pulse()
        for thread in self._threads:
            if isinstance(thread.error, TwinError) and thread.has_begun:
                raise NodeFailedError(str(thread.error)) from thread.error
            if thread.error is not None:
                raise thread.error

    def close(self) -> None:
        """Ends all traffic."""
        self._wire.close()

    @property
    def _concerned(self) -> list[NodeThread]:
        """Nodes that know something which a jump in time makes untrue."""
        return [thread for thread in self._threads if thread.name not in SOURCES]

    def _on_clock_put_back(self) -> None:
        if self._concerned:
            self._say(
                "the computer's clock was put back: what was stamped before is later than now, so all begins anew"
            )
        self._begin_anew()

    def _begin_anew(self) -> None:
        for thread in self._concerned:
            thread.begin_anew()


def _set_clock(clock: FollowedClock, message: Message) -> None:
    clock.set(convert.clock_from_message(message.decode() if isinstance(message, Encoded) else message))
