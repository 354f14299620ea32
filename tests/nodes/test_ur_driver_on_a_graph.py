"""`twin_node ur-driver` beside a running graph: it obeys what that decides, and tells it of the arm."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import pytest
from launching import PATIENCE_S, Ear

from twin_node.arm.ur import DriverReport, DriverState, Halt, UrParameters
from twin_node.bench.graph_run import free_endpoint
from twin_node.cell.ur_sim import StandInParameters, StandInProcess, free_loopback
from twin_node.cli import main
from twin_node.messages import convert, message_type
from twin_node.nodes.live.arm_driver import make_ur_driver
from twin_node.nodes.live.asking import Asking
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import ACKNOWLEDGE, JOINT_STATES, SEPARATION, GraphError, kind_of
from twin_node.nodes.ur_driver import DRIVER, UrDriverNode
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.neighbours import NodeNames
from twin_node.runtime.node import Node
from twin_node.runtime.services import ServiceClient
from twin_node.runtime.wire_bus import WireBus
from twin_node.runtime.zenoh_session import ZenohParameters, open_router
from twin_node.runtime.zenoh_wire import ZenohWire
from twin_node.scene import Separation

pytest.importorskip("rtde_io", reason="ur_rtde is not installed (extra 'ur')")
pytest.importorskip("zenoh")

FRACTION = 0.1
"""Told to the arm: so little is reached before a busy machine can be late."""


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Iterator[ZenohParameters]:
    """A graph of the test's own, which commands find."""
    parameters = ZenohParameters(endpoint=free_endpoint(), domain=0)
    monkeypatch.setattr("twin_node.nodes.live.single.ZenohParameters", lambda: parameters)
    asked = partial(ZenohParameters, endpoint=parameters.endpoint, domain=0)
    monkeypatch.setattr("twin_node.runtime.zenoh_session.ZenohParameters", asked)
    router = open_router(parameters)
    assert router is not None
    yield parameters
    router.close()


class Twin(threading.Thread):
    """Decides and acknowledges until the arm obeys and is heard of, then ends the command that drives it."""

    def __init__(self, endpoint: str, is_obeyed: Callable[[], bool]) -> None:
        super().__init__()
        self._endpoint, self._is_obeyed = endpoint, is_obeyed
        self.joints: list[object] = []

    def run(self) -> None:
        try:
            with Ear(self._endpoint) as ear:
                ear.bus.subscribe(JOINT_STATES, self.joints.append)
                last = time.monotonic() + PATIENCE_S
                while not (self.joints and self._is_obeyed()) and time.monotonic() < last:
                    now = time.time_ns()
                    told = Separation.without_pair(now, now, FRACTION, "slow")
                    ear.bus.publish(SEPARATION, convert.separation_to_message(told))
                    ear.bus.publish(ACKNOWLEDGE, message_type("std_msgs/msg/Empty")())
                    ear.step(0.02)
        finally:
            os.kill(os.getpid(), signal.SIGINT)


def test_enter_is_answered(graph: ZenohParameters, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing was said to somebody who pressed it while no arm was reached."""
    said = []

    def say(line: str, flush: bool) -> None:
        said.append(line)
        if line.startswith("acknowledge: "):
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("twin_node.cli.ur_driver.print", say, raising=False)
    keyboard, terminal = os.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        os.write(keyboard, b"\n")
        assert main(["ur-driver", "--robot", free_loopback(), "--duration", str(PATIENCE_S)]) == 0
    os.close(keyboard)
    assert said[-1].startswith("acknowledge: no halt waits for somebody; ")


def test_the_command_obeys_the_graph_and_tells_it_of_the_arm(graph: ZenohParameters) -> None:
    """It was on no graph: beside a twin its arm stood for ever."""
    with StandInProcess(StandInParameters(host=free_loopback())) as stand_in:
        twin = Twin(graph.endpoint, lambda: stand_in.status().speed_slider == pytest.approx(FRACTION))
        twin.start()
        assert main(["ur-driver", "--robot", stand_in.host]) == 0
        twin.join()
        assert twin.joints
        assert stand_in.status().speed_slider == 0.0  # it has ended


class Asker(threading.Thread):
    """Asks the driver of a command, and then ends it."""

    def __init__(self, graph: ZenohParameters) -> None:
        super().__init__()
        self._graph = graph
        self.answers: list[object] = []

    def run(self) -> None:
        until = time.monotonic() + PATIENCE_S
        with Asking(self._graph) as asking:
            while not self.answers and time.monotonic() < until:
                with contextlib.suppress(GraphError):  # it is not there yet
                    values, state = asking.values(f"/{DRIVER}", ["mode"]), asking.state(f"/{DRIVER}")
                    self.answers += [values, state, asking.transitions(f"/{DRIVER}")]
            self.answers += [asking.acknowledge()[1], asking.change(f"/{DRIVER}", "shutdown")]


def test_the_command_answers_what_others_ask_and_can_be_shut_down(graph: ZenohParameters) -> None:
    """Its node had no services: nobody could read its parameters, or end it."""
    asker = Asker(graph)
    asker.start()
    assert main(["ur-driver", "--robot", free_loopback(), "--mode", "servo"]) == 0
    asker.join()
    values, state, possible, words, ended = asker.answers
    assert (values, state, ended) == ({"mode": "servo"}, "active", "finalized")
    assert possible == {"shutdown": 7}, "and nothing else, which it could not do"
    assert "no halt waits for somebody" in str(words)


def test_a_second_driver_of_a_graph_is_refused(graph: ZenohParameters, refused: Callable[..., str]) -> None:
    with NodeNames(graph, ["ur_driver"]):
        error = refused("ur-driver", "--robot", free_loopback())
    assert "node 'ur_driver' is alive already in ROS domain 0" in error


class Halted:
    """Stands for a driver of an arm that is halted until somebody acknowledges; `why`: and then why it still is."""

    def __init__(self, why: str | None = None) -> None:
        self.latest = DriverReport(0, DriverState.HALTED, "no forecast")
        self.halt: Halt | None = None
        self.acknowledged = 0
        self._why = why
        self._on_report: Callable[[DriverReport], None] = lambda report: None

    def __call__(self, parameters: object, on_report: Callable[[DriverReport], None]) -> Halted:
        """This one, in place of one that would connect to a controller."""
        self._on_report = on_report
        return self

    def acknowledge(self) -> None:
        self.acknowledged += 1
        if self._why is None:
            self.latest = replace(self.latest, state=DriverState.READY)
        else:
            for refusal in ("trajectory: refused while halted", self._why):
                self._on_report(replace(self.latest, refusal=refusal))

    def close(self) -> None:
        pass


@contextlib.contextmanager
def driven(graph: ZenohParameters, driver: Halted, monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    """The node of a driver on the graph, as a launch makes it and has it run in a thread."""
    monkeypatch.setattr("twin_node.nodes.ur_driver.SupervisedDriver", driver)
    executor, wire = Executor(), ZenohWire(graph)
    bus = WireBus(wire, executor, DRIVER, kind_of)
    sections = {DRIVER: {"robot": "127.0.0.1"}}
    node = make_ur_driver(Setup(DRIVER, bus, SystemClock(), executor, sections, "test", executor.stop, wire.endpoints))
    node.configure()
    node.activate()
    running = threading.Thread(target=executor.spin)
    running.start()
    try:
        yield node
    finally:
        executor.stop()
        running.join()
        bus.close()
        wire.close()


@pytest.mark.parametrize("namespace", ["/", "/line/cell"])
def test_a_halt_of_a_launched_driver_is_acknowledged_by_a_command(
    graph: ZenohParameters, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, namespace: str
) -> None:
    """Without ROS nothing on the graph could, and a launch had to be begun anew."""
    driver = Halted()
    with driven(replace(graph, namespace=namespace), driver, monkeypatch):
        for said in ("acknowledged what had halted: no forecast; now ready", "no halt waits for somebody; ready"):
            assert main(["acknowledge", "--namespace", namespace]) == 0
            assert capsys.readouterr().out.splitlines()[-1] == f"{said}: no forecast"
    assert driver.acknowledged == 1


def test_why_a_halt_is_not_over_is_told_to_who_acknowledges_it(
    graph: ZenohParameters, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not what is refused of a path meanwhile."""
    with driven(graph, Halted("acknowledge: expected an arm that stands"), monkeypatch):
        assert main(["acknowledge"]) == 1
    assert capsys.readouterr().err == "still halted: no forecast; acknowledge: expected an arm that stands\n"


@pytest.mark.parametrize("refused", ["trajectory: refused while halted", "JointTrajectory point 1: 5 positions"])
def test_a_halt_that_goes_on_whatever_is_said_is_told_after_a_while(
    graph: ZenohParameters, monkeypatch: pytest.MonkeyPatch, refused: str
) -> None:
    """What was refused of a path, by the driver or as no path at all, is no answer."""
    driver = Halted(refused)
    with driven(graph, driver, monkeypatch), Asking(graph) as asking:
        assert asking.acknowledge() == (False, "still halted: no forecast; what halts it is not over")


def test_who_waits_for_a_driver_that_is_deactivated_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[bool, str]] = []
    monkeypatch.setattr("twin_node.nodes.ur_driver.SupervisedDriver", Halted("trajectory: refused"))
    node = UrDriverNode(LocalBus(), SystemClock(), UrParameters(robot="127.0.0.1"))
    node.configure()
    node.acknowledge(lambda *answer: told.append(answer))
    node.activate()
    node.acknowledge(lambda *answer: told.append(answer))
    node.deactivate()
    assert told == [
        (False, "the driver is not active"),
        (False, "was halted: no forecast; the driver has been deactivated since"),
    ]


@pytest.mark.parametrize("state", [DriverState.LOST, DriverState.CONNECTING])
def test_a_halt_of_an_arm_that_is_not_reached_waits_for_who_acknowledges_too_early(
    monkeypatch: pytest.MonkeyPatch, state: DriverState
) -> None:
    """It was said that none waits, and that the arm is not halted; it was, as soon as it was reached again."""
    told: list[tuple[bool, str]] = []
    driver = Halted()
    driver.latest = DriverReport(0, state, "connection lost")
    monkeypatch.setattr("twin_node.nodes.ur_driver.SupervisedDriver", driver)
    node = UrDriverNode(LocalBus(), SystemClock(), UrParameters(robot="127.0.0.1"))
    node.configure()
    node.activate()
    for driver.halt in (Halt("no forecast"), None):
        node.acknowledge(lambda *answer: told.append(answer))
    words = f"{state.value}: connection lost"
    assert told == [
        (False, f"{words}; it is halted when it is reached again (no forecast): acknowledge then"),
        (True, f"no halt waits for somebody; {words}"),
    ]
    assert driver.acknowledged == 0


@pytest.mark.parametrize(
    ("state", "told"),
    [
        (DriverState.READY, (True, "acknowledged what had halted: no forecast; now ready: it begins")),
        (
            DriverState.LOST,
            (False, "was halted: no forecast; now lost: it begins; acknowledge when it is reached again"),
        ),
    ],
)
def test_who_acknowledges_hears_what_comes_of_it_once_the_control_script_has_begun_or_not(
    monkeypatch: pytest.MonkeyPatch, state: DriverState, told: tuple[bool, str]
) -> None:
    """However long a servoed arm's script takes: after 3 s it was said that what halts is not over, and it went on."""
    heard: list[tuple[bool, str]] = []
    monkeypatch.setattr("twin_node.nodes.ur_driver._PATIENCE_NS", 0)
    driver = Halted("trajectory: refused")
    monkeypatch.setattr("twin_node.nodes.ur_driver.SupervisedDriver", driver)
    node = UrDriverNode(LocalBus(), SystemClock(), UrParameters(robot="127.0.0.1"))
    node.configure()
    node.activate()
    node.acknowledge(lambda *answer: heard.append(answer))
    driver.latest = DriverReport(0, DriverState.CONNECTING, "it begins")
    node.tick()
    assert heard == []
    driver.latest = DriverReport(0, state, "it begins")
    node.tick()
    assert heard == [told]


def test_who_acknowledges_where_no_arm_is_driven_is_told(graph: ZenohParameters, refused: Callable[..., str]) -> None:
    assert "expected the driver of an arm on the graph of this machine to serve it, found none" in refused(
        "acknowledge"
    )


def test_who_acknowledges_to_a_driver_that_hangs_is_told(
    graph: ZenohParameters, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not that there is none."""
    monkeypatch.setattr(ServiceClient, "ask", lambda self, name, service: None)
    with driven(graph, Halted(), monkeypatch):
        assert "expected the driver of the arm to answer within 10 s, but it did not" in refused("acknowledge")


def test_a_driver_that_is_just_being_started_is_waited_for(
    graph: ZenohParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its service is not known on the graph before it is: it was said that there is none."""
    monkeypatch.setattr("twin_node.nodes.live.asking.APPEARS_S", PATIENCE_S)
    with Asking(graph) as asking:
        answers: list[tuple[bool, str]] = []
        asker = threading.Thread(target=lambda: answers.append(asking.acknowledge()))
        asker.start()
        with driven(graph, Halted(), monkeypatch):
            asker.join(PATIENCE_S)
    assert answers == [(True, "acknowledged what had halted: no forecast; now ready: no forecast")]
