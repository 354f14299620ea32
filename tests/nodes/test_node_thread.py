"""A node in its thread: lifecycle in order, diagnostics, failures, and a fresh node whenever time jumps."""

from __future__ import annotations

import gc
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable
from typing import Any

import pytest

from twin_node.errors import TwinError
from twin_node.messages import convert, message_type
from twin_node.nodes.launch import node_thread
from twin_node.nodes.launch.node_thread import STUCK_S, Graph, NodeFailedError, NodeThread
from twin_node.nodes.launch.order import Order
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import DIAGNOSTICS, JOINT_STATES, ROSOUT, kind_of
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.node import LifecycleState, Node
from twin_node.runtime.wire import LocalWire, Send

WAIT_S = 60.0
ORDER = Order(("counter",), {}, False, False, {}, {}, "test")


class Counter(Node):
    """Counts the messages that it is sent while it is active; one that is named `bug` it cannot survive."""

    def __init__(self, setup: Setup, life: list[str], heard: threading.Semaphore) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self.count = 0
        self._life, self._heard = life, heard

    def on_configure(self) -> None:
        self._life.append("configure")
        self.bus.subscribe(JOINT_STATES, self._on_joints)

    def on_activate(self) -> None:
        self._life.append("activate")
        self._heard.release()

    def on_deactivate(self) -> None:
        self._life.append("deactivate")

    def on_cleanup(self) -> None:
        self._life.append("cleanup")

    def diagnoses(self) -> tuple[convert.Diagnosis, ...]:
        return (convert.Diagnosis("counter: joints", convert.Level.OK, f"{self.count}"),)

    def _on_joints(self, message: Any) -> None:
        if message.name == ["bug"]:
            raise ZeroDivisionError
        if message.name == ["odd"]:
            raise TwinError("joints of another arm")
        self.count += 1
        self._heard.release()


class Bench:
    """A node's thread on a local wire."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.life: list[str] = []
        self.nodes: list[Counter] = []
        self.heard, self.ended = threading.Semaphore(0), threading.Event()
        self.wire = LocalWire()
        monkeypatch.setattr(node_thread, "find_factory", lambda name: self.make)
        self.thread = NodeThread("counter", ORDER, self.wire, SystemClock(), self.ended.set, print)
        self.send: Send = self.wire.publisher("test", JOINT_STATES, kind_of(JOINT_STATES))

    def make(self, setup: Setup) -> Counter:
        self.nodes.append(Counter(setup, self.life, self.heard))
        return self.nodes[-1]

    def joints(self, name: str) -> Any:
        kind = message_type("sensor_msgs/msg/JointState")
        header = convert.clock_to_message(0).clock
        values: list[float] = []
        return kind(
            header=message_type("std_msgs/msg/Header")(stamp=header, frame_id=""),
            name=[name],
            position=values,
            velocity=values,
            effort=values,
        )

    def begin(self) -> None:
        self.thread.configure()
        self.thread.start()
        self.thread.activate()
        assert self.heard.acquire(timeout=WAIT_S)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_a_node_is_led_through_its_life(bench: Bench) -> None:
    bench.begin()
    bench.send(bench.joints("a"))
    assert bench.heard.acquire(timeout=WAIT_S)
    bench.thread.stop()
    assert bench.life == ["configure", "activate", "deactivate", "cleanup"]
    assert bench.nodes[0].count == 1
    assert bench.thread.error is None


def test_a_jump_in_time_makes_the_node_anew(bench: Bench) -> None:
    bench.begin()
    bench.send(bench.joints("a"))
    assert bench.heard.acquire(timeout=WAIT_S)
    bench.thread.begin_anew()
    assert bench.heard.acquire(timeout=WAIT_S)
    bench.send(bench.joints("b"))
    assert bench.heard.acquire(timeout=WAIT_S)
    bench.thread.stop()
    first, second = bench.nodes
    assert (first.count, second.count) == (1, 1)
    assert first.state is second.state is LifecycleState.UNCONFIGURED
    assert bench.life == ["configure", "activate", "deactivate", "cleanup"] * 2


def test_of_many_jumps_in_time_at_once_one_is_enough_and_no_order_is_lost(bench: Bench) -> None:
    """As of a short log that is played fast, again and again: each made a twin anew, for which it takes a second."""
    bench.thread.configure()
    bench.thread.activate()
    for _ in range(20):
        bench.thread.begin_anew()
    bench.thread.start()
    assert bench.heard.acquire(timeout=WAIT_S)
    assert bench.heard.acquire(timeout=WAIT_S)
    bench.thread.stop()
    assert bench.life == ["configure", "activate", "deactivate", "cleanup"] * 2


def test_a_node_that_was_made_anew_is_let_go(bench: Bench) -> None:
    """At once: a process of a launch looks for garbage rarely, and nodes and their buses hold each other."""
    gc.disable()
    try:
        bench.begin()
        first = weakref.ref(bench.nodes.pop())
        bench.thread.begin_anew()
        assert bench.heard.acquire(timeout=WAIT_S)
        assert first() is None
    finally:
        gc.enable()
    bench.thread.stop()


def test_what_a_node_cannot_use_is_told_and_what_it_cannot_survive_ends_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node_thread, "DIAGNOSTICS_PERIOD_S", 0.01)
    told: list[Any] = []
    arrived, recovered = threading.Event(), threading.Event()

    def hear(message: Any) -> None:
        told.append(convert.diagnostics_from_message(message))
        if any("joints of another arm" in d.message for d in told[-1]):
            arrived.set()
        elif arrived.is_set():
            recovered.set()

    bench.wire.subscribe("test", DIAGNOSTICS, kind_of(DIAGNOSTICS), hear)
    bench.begin()
    bench.send(bench.joints("odd"))
    assert arrived.wait(WAIT_S)
    assert {d.name for d in told[-1]} == {"counter: messages", "counter: joints"}
    assert recovered.wait(WAIT_S), "one message was a warning for as long as the node lived"
    [reading] = told[-1][0].readings
    assert (reading.key, reading.value) == (f"unusable {JOINT_STATES}", "1")
    bench.send(bench.joints("bug"))
    assert bench.ended.wait(WAIT_S)
    assert isinstance(bench.thread.error, ZeroDivisionError)
    assert bench.life[-2:] == ["deactivate", "cleanup"]


@pytest.mark.parametrize(("namespace", "logger"), [("/", "talker"), ("/line/cell", "line.cell.talker")])
def test_what_a_node_tells_is_told_to_the_graph_too(
    monkeypatch: pytest.MonkeyPatch, namespace: str, logger: str
) -> None:
    """Also what it told before it joined, from whatever thread: consoles of ROS 2 read /rosout."""
    said: list[str] = []
    setups: list[Setup] = []
    monkeypatch.setattr(node_thread, "find_factory", lambda name: lambda setup: setups.append(setup) or Talker(setup))
    wire, arrived = LocalWire(), threading.Semaphore(0)
    wire.namespace = namespace
    heard: list[Any] = []
    wire.subscribe("console", ROSOUT, kind_of(ROSOUT), lambda message: (heard.append(message), arrived.release()))
    thread = NodeThread("talker", ORDER, wire, SystemClock(), lambda: None, said.append)
    thread.make()
    assert said == ["made"]
    thread.configure()
    thread.start()
    thread.activate()
    for _ in range(3):
        assert arrived.acquire(timeout=WAIT_S)
    thread.stop()
    assert said == ["made", "configured", "active"] == [message.msg for message in heard]
    assert {(message.name, message.level) for message in heard} == {(logger, heard[0].INFO)}
    assert setups[0].namespace == namespace
    assert heard[0].stamp.sec > 1_700_000_000


class Talker(Node):
    """Says what becomes of it."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self._say = setup.say
        self._say("made")

    def on_configure(self) -> None:
        self._say("configured")

    def on_activate(self) -> None:
        thread = threading.Thread(target=self._say, args=("active",))
        thread.start()
        thread.join()


class LateLocalWire(LocalWire):
    """A local wire that is opened as a process's is."""

    def __init__(self, _: object) -> None:
        super().__init__()

    def open(self) -> None:
        """It is."""


class Failing(Node):
    """Cannot begin, or fails of a timer once it has begun."""

    def __init__(self, setup: Setup, begins: bool) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self._timers, self._begins = setup.timers, begins

    def on_activate(self) -> None:
        if not self._begins:
            self._fail()
        self._timers.every(0.001, self._fail)

    def on_deactivate(self) -> None:
        raise ValueError("what is not open cannot be closed")

    def _fail(self) -> None:
        raise TwinError("the disk is full")


@pytest.mark.parametrize(("begins", "expected"), [(False, TwinError), (True, NodeFailedError)])
def test_what_ends_a_node_that_had_begun_was_not_refused(
    monkeypatch: pytest.MonkeyPatch, begins: bool, expected: type[Exception]
) -> None:
    monkeypatch.setattr(node_thread, "LateWire", LateLocalWire)
    monkeypatch.setattr(node_thread, "find_factory", lambda name: lambda setup: Failing(setup, begins))
    graph = Graph(ORDER, print)
    graph.make()
    graph.configure()
    graph.activate()
    with pytest.raises(expected, match="the disk is full") as raised:
        graph.run(lambda: None)
    assert type(raised.value) is expected
    graph.close()


def test_a_process_tells_that_it_goes_on_unless_a_node_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_thread, "PULSE_S", 0.0)
    graph = Graph(ORDER, print)
    (thread,) = graph._threads
    stuck_for = [0.0]
    monkeypatch.setattr(Executor, "busy_s", property(lambda _: stuck_for.pop() if stuck_for else 0.0))
    pulses: list[int] = []

    def pulse() -> None:
        pulses.append(len(stuck_for))
        if not stuck_for:
            graph.stop()

    stuck_for[:] = [2 * STUCK_S, 2 * STUCK_S, 1.0]
    ends = [True, False, False]  # it takes its time, too
    monkeypatch.setattr(thread, "stop", lambda _: ends.pop())
    graph.run(pulse)
    assert pulses == [2, 0, 0, 0], "none while it is stuck"
    graph.close()


def test_a_node_that_hangs_in_its_end_is_stuck_too(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one whose camera does not come back from reading: its process, which had failed, was never started again."""
    goes_on, is_ending = threading.Event(), threading.Event()

    def hang(_: Counter) -> None:
        is_ending.set()
        assert goes_on.wait(WAIT_S)

    monkeypatch.setattr(Counter, "on_deactivate", hang)
    monkeypatch.setattr(node_thread, "STUCK_S", 0.0)
    bench.begin()
    assert not bench.thread.stop(0.0)
    assert is_ending.wait(WAIT_S)
    assert bench.thread.is_stuck
    goes_on.set()
    assert bench.thread.stop(WAIT_S)
    assert not bench.thread.is_stuck


class Refusing(Node):
    """Cannot be configured."""

    def on_configure(self) -> None:
        raise TwinError("no such log")


def test_nodes_beside_one_that_is_refused_are_cleaned_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A recorder beside a player without a log must not leave an empty recording behind."""
    life: list[str] = []

    def factory(name: str) -> Callable[[Setup], Node]:
        if name == "counter":
            return lambda setup: Counter(setup, life, threading.Semaphore(0))
        return lambda setup: Refusing(setup.name, setup.bus, setup.clock)

    monkeypatch.setattr(node_thread, "LateWire", LateLocalWire)
    monkeypatch.setattr(node_thread, "find_factory", factory)
    graph = Graph(Order(("refusing", "counter"), {}, False, False, {}, {}, "test"), print)
    graph.make()
    with pytest.raises(TwinError, match="no such log"):
        graph.configure()
    assert life == ["configure", "cleanup"]
    graph.close()


def test_no_process_but_the_twins_loads_torch() -> None:
    program = """
import sys
from twin_node.nodes.launch import host, node_thread
from twin_node.nodes.launch.kinds import KINDS, find_factory
for name in KINDS.keys() - {"twin"}:
    find_factory(name)
sys.exit("torch" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=120).returncode == 0


@pytest.mark.parametrize("name", ["synchronizer", "arm", "ur_driver", "viewer_topics"])
def test_processes_between_cameras_and_arm_start_without_scipy(name: str) -> None:
    """Half of their start would be its imports; what a description of an arm needs of it is loaded when asked for."""
    program = f"""
import sys
from twin_node.nodes.launch.kinds import find_factory
from twin_node.robot import ur_model
find_factory("{name}")
ur_model("ur5e")
sys.exit("scipy" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=120).returncode == 0


@pytest.mark.parametrize(
    ("nodes", "made"), [(("synchronizer", "ur_driver", "cell"), ["synchronizer", "cell"]), (("ur_driver",), [])]
)
def test_the_nodes_of_a_process_are_made_anew_when_the_computers_clock_is_put_back(
    monkeypatch: pytest.MonkeyPatch, nodes: tuple[str, ...], made: list[str]
) -> None:
    """Images stamped by the new time would be older than all that came before, and refused until it has caught up; the
    simulated cell would wait until then before it sends the next. A driver's process, in which nothing begins anew,
    said that all does."""
    jumps: list[Callable[[], None]] = []
    monkeypatch.setattr(node_thread, "SystemClock", lambda on_jump_back: jumps.append(on_jump_back) or SystemClock())
    said: list[str] = []
    graph = Graph(Order(nodes, {}, False, False, {}, {}, "test"), said.append)
    anew: list[str] = []
    monkeypatch.setattr(NodeThread, "begin_anew", lambda self: anew.append(self.name))
    for jump in jumps:
        jump()
    graph.close()
    assert (anew, len(said)) == (made, bool(made))
