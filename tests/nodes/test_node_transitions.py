"""A node of a launch that others lead through its life, while the rest of the graph goes on."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest

from twin_node.messages import convert
from twin_node.nodes.launch import node_thread
from twin_node.nodes.launch.node_thread import NodeThread
from twin_node.nodes.launch.order import Order
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import CLOCK, DIAGNOSTICS, kind_of
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.lifecycle_services import Transition
from twin_node.runtime.node import LifecycleState, Node
from twin_node.runtime.services import PATIENCE_S
from twin_node.runtime.wire import LocalWire

WAIT_S = 60.0
ORDER = Order(("echo",), {"echo": {}}, True, False, {}, {}, "test")


class Echo(Node):
    """Counts what it hears and ticks, whatever its state; it fails of a transition that it is told to fail of."""

    def __init__(self, setup: Setup, fails: set[str], life: list[str]) -> None:
        super().__init__(setup.name, setup.bus, setup.clock)
        self.heard = threading.Semaphore(0)
        self.ticked = threading.Event()
        self._timers, self._fails, self._life = setup.timers, fails, life

    def on_configure(self) -> None:
        self._do("configure")
        self.bus.subscribe(CLOCK, lambda _: self.heard.release())
        self._timers.every(0.005, self.ticked.set)

    def on_activate(self) -> None:
        self._do("activate")

    def on_deactivate(self) -> None:
        self._do("deactivate")

    def on_cleanup(self) -> None:
        self._do("cleanup")

    def _do(self, what: str) -> None:
        self._life.append(what)
        if what in self._fails:
            raise ValueError(f"cannot {what}")


class Bench:
    """Its thread on a local wire, active."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.life: list[str] = []
        self.said: list[str] = []
        self.fails: set[str] = set()
        self.nodes: list[Echo] = []
        self.ended = threading.Event()
        self.wire = LocalWire()
        monkeypatch.setattr(node_thread, "find_factory", lambda name: self.make)
        self.thread = NodeThread("echo", ORDER, self.wire, SystemClock(), self.ended.set, self.said.append)
        self.send = self.wire.publisher("test", CLOCK, kind_of(CLOCK))
        self.thread.configure()
        self.thread.start()
        assert self.go(Transition.ACTIVATE)

    def make(self, setup: Setup) -> Echo:
        self.nodes.append(Echo(setup, self.fails, self.life))
        return self.nodes[-1]

    def go(self, transition: Transition) -> bool:
        """Whether the node went through a transition."""
        answers: list[bool] = []
        done = threading.Event()
        self.thread.change(transition, lambda success: (answers.append(success), done.set()))
        assert done.wait(WAIT_S)
        return answers[0]

    def is_heard(self, patience_s: float) -> bool:
        self.send(convert.clock_to_message(1))
        return self.nodes[-1].heard.acquire(timeout=patience_s)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_a_deactivated_node_does_nothing_until_it_is_activated(bench: Bench) -> None:
    """It neither hears nor ticks; then it begins anew: what it knew is old."""
    assert bench.is_heard(WAIT_S)
    assert bench.go(Transition.DEACTIVATE)
    assert bench.thread.lifecycle is LifecycleState.INACTIVE
    bench.nodes[0].ticked.clear()
    assert not bench.is_heard(0.05)
    assert not bench.nodes[0].ticked.is_set()
    assert bench.go(Transition.ACTIVATE)
    assert bench.thread.lifecycle is LifecycleState.ACTIVE
    assert bench.is_heard(WAIT_S)
    assert bench.nodes[1].ticked.wait(WAIT_S)
    bench.thread.stop()
    assert bench.life == ["configure", "activate", "deactivate", "cleanup"] * 2
    assert bench.thread.error is None


@pytest.mark.parametrize("again", [False, True])
def test_a_node_that_somebody_has_led_before_its_launch_activates_it_is_none_that_fails(
    bench: Bench, again: bool
) -> None:
    """Cleaned up while other processes loaded it ended in an assertion; configured again it was active and deaf."""
    for transition in (Transition.DEACTIVATE, Transition.CLEANUP, *([Transition.CONFIGURE] if again else [])):
        assert bench.go(transition)
    bench.thread.activate()
    assert not bench.go(Transition.CLEANUP)  # its place is behind the launch's order
    assert bench.thread.lifecycle is (LifecycleState.ACTIVE if again else LifecycleState.UNCONFIGURED)
    assert not again or bench.is_heard(WAIT_S)
    bench.thread.stop()
    assert bench.thread.error is None


def test_nothing_ticks_of_a_node_whose_place_another_has_taken(bench: Bench) -> None:
    bench.thread.begin_anew()
    assert not bench.go(Transition.CONFIGURE)  # another one by now, and active
    before, after = bench.nodes
    before.ticked.clear()
    for _ in range(4):
        after.ticked.clear()
        assert after.ticked.wait(WAIT_S)
    assert not before.ticked.is_set()
    bench.thread.stop()


def test_whoever_launched_a_node_is_told_of_its_transitions(bench: Bench) -> None:
    """Somebody shut the arm's node down: it stood for good, and the launch had nothing to say of it."""
    bench.said.clear()
    assert bench.go(Transition.DEACTIVATE)
    assert bench.go(Transition.INACTIVE_SHUTDOWN)
    assert bench.said == ["node echo deactivated, as somebody asked", "node echo shut down, as somebody asked"]


def test_a_transition_that_nobody_waits_for_any_more_is_not_gone_through(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A node that hung would be active, or end, when it comes to itself, though its user was told that it is dead."""
    hangs, begun = threading.Event(), threading.Event()
    real, late = time.monotonic, [0.0]
    monkeypatch.setattr("twin_node.runtime.executor.time", SimpleNamespace(monotonic=lambda: real() + late[0]))
    bench.thread.change(Transition.CONFIGURE, lambda _: (begun.set(), hangs.wait(WAIT_S)))
    assert begun.wait(WAIT_S)
    bench.thread.change(Transition.DEACTIVATE, lambda _: None)
    late[0] = PATIENCE_S
    hangs.set()
    assert bench.is_heard(WAIT_S)
    assert bench.thread.lifecycle is LifecycleState.ACTIVE
    bench.thread.stop()


def test_a_node_can_be_cleaned_up_and_configured(bench: Bench) -> None:
    for transition, state in (
        (Transition.DEACTIVATE, LifecycleState.INACTIVE),
        (Transition.CLEANUP, LifecycleState.UNCONFIGURED),
        (Transition.CONFIGURE, LifecycleState.INACTIVE),
        (Transition.ACTIVATE, LifecycleState.ACTIVE),
    ):
        assert bench.go(transition)
        assert bench.thread.lifecycle is state
        if state is LifecycleState.INACTIVE:
            assert not bench.is_heard(0.05), "nor does one that is only configured do anything"
    bench.thread.stop()
    whole = ["configure", "activate", "deactivate", "cleanup"]
    assert bench.life == [*whole, "configure", "cleanup", *whole], "that one begins anew, too"


@pytest.mark.parametrize("after", [(), (Transition.DEACTIVATE,), (Transition.DEACTIVATE, Transition.CLEANUP)])
def test_a_node_ends_from_any_state_that_it_is_in(bench: Bench, after: tuple[Transition, ...]) -> None:
    for transition in after:
        assert bench.go(transition)
    shutdown = (Transition.ACTIVE_SHUTDOWN, Transition.INACTIVE_SHUTDOWN, Transition.UNCONFIGURED_SHUTDOWN)[len(after)]
    assert bench.go(shutdown)
    assert bench.ended.wait(WAIT_S)
    assert bench.thread.error is None
    assert bench.life == ["configure", "activate", "deactivate", "cleanup"]


def test_a_transition_that_another_was_quicker_with_is_refused(bench: Bench) -> None:
    assert bench.go(Transition.DEACTIVATE)
    assert not bench.go(Transition.DEACTIVATE)
    assert not bench.go(Transition.CONFIGURE)
    assert bench.thread.lifecycle is LifecycleState.INACTIVE
    bench.thread.stop()


def test_a_node_that_fails_of_a_transition_says_so_and_ends_its_process(bench: Bench) -> None:
    """Which is started again, as after any other fault."""
    assert bench.go(Transition.DEACTIVATE)
    bench.fails.add("activate")
    assert not bench.go(Transition.ACTIVATE)
    assert bench.ended.wait(WAIT_S)
    assert str(bench.thread.error) == "cannot activate"


def test_a_jump_in_time_leaves_a_node_in_its_state(bench: Bench) -> None:
    assert bench.go(Transition.DEACTIVATE)
    bench.thread.begin_anew()
    assert not bench.go(Transition.DEACTIVATE), "it has looked at the jump by now, and is inactive"
    assert not bench.is_heard(0.05)
    assert bench.go(Transition.ACTIVATE)
    assert bench.go(Transition.DEACTIVATE)
    assert bench.go(Transition.CLEANUP)
    bench.thread.begin_anew()
    assert bench.go(Transition.CONFIGURE), "it was unconfigured"
    bench.thread.stop()


def test_diagnostics_tell_of_a_node_that_was_deactivated(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_thread, "DIAGNOSTICS_PERIOD_S", 0.01)
    told, arrived = [], threading.Event()

    def hear(message: Any) -> None:
        told.append(convert.diagnostics_from_message(message))
        arrived.set()

    assert bench.go(Transition.DEACTIVATE)
    bench.wire.subscribe("test", DIAGNOSTICS, kind_of(DIAGNOSTICS), hear)
    assert arrived.wait(WAIT_S)
    [one] = told[-1]
    assert (one.name, one.level) == ("echo: lifecycle", convert.Level.WARN)
    assert "twin_node lifecycle set /echo activate" in one.message
    bench.thread.stop()


def test_a_node_has_the_parameter_that_every_node_of_ros_has(bench: Bench) -> None:
    surroundings: tuple[Any, ...] = (None, SystemClock(), None, {}, "test", print, tuple)
    setup = Setup("echo", *surroundings)
    assert setup.read(follows_clock=True)["use_sim_time"].value is True
    assert setup.read(follows_clock=False)["use_sim_time"].value is False
    bench.thread.stop()


def test_who_asks_for_a_state_while_the_node_is_taken_away_is_answered(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was looked at twice, and once it had gone between the two looks nobody was answered."""
    bench.thread.stop()
    looks = iter(bench.nodes)
    monkeypatch.setattr(NodeThread, "_node", property(lambda _: next(looks, None)), raising=False)
    assert bench.thread.lifecycle is LifecycleState.UNCONFIGURED
