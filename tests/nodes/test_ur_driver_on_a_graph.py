"""`twin_node ur-driver` beside a running graph: it obeys what that decides, and tells it of the arm."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from launching import PATIENCE_S, Ear

from twin_node.bench.graph_run import free_endpoint
from twin_node.cell.ur_sim import StandInParameters, StandInProcess, free_loopback
from twin_node.cli import main
from twin_node.messages import convert, message_type
from twin_node.nodes.topics import ACKNOWLEDGE, DIAGNOSTICS, JOINT_STATES, SEPARATION
from twin_node.nodes.ur_driver import DRIVEN_ARM
from twin_node.runtime.neighbours import NodeNames
from twin_node.runtime.zenoh_session import ZenohParameters, open_router
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


def test_the_command_obeys_the_graph_and_tells_it_of_the_arm(graph: ZenohParameters) -> None:
    """It was on no graph: beside a twin its arm stood for ever."""
    with StandInProcess(StandInParameters(host=free_loopback())) as stand_in:
        twin = Twin(graph.endpoint, lambda: stand_in.status().speed_slider == pytest.approx(FRACTION))
        twin.start()
        assert main(["ur-driver", "--robot", stand_in.host]) == 0
        twin.join()
        assert twin.joints
        assert stand_in.status().speed_slider == 0.0  # it has ended


def test_a_second_driver_of_a_graph_is_refused(graph: ZenohParameters, refused: Callable[..., str]) -> None:
    with NodeNames(graph, ["ur_driver"]):
        error = refused("ur-driver", "--robot", free_loopback())
    assert "node 'ur_driver' is alive already in ROS domain 0" in error


class HaltedDriver(threading.Thread):
    """Says once in a while that the arm is halted, until somebody acknowledges; `refuses`: and then why it still is."""

    def __init__(self, endpoint: str, state: str, refuses: bool) -> None:
        super().__init__()
        self._endpoint, self._state, self._refuses = endpoint, state, refuses
        self.acknowledged = 0
        self.ended = threading.Event()

    def run(self) -> None:
        with Ear(self._endpoint) as ear:
            ear.bus.subscribe(ACKNOWLEDGE, self._on_acknowledge)
            while not self.ended.is_set():
                refused = [convert.Reading("refused", "it still brakes")] * (self._refuses and self.acknowledged > 0)
                readings = (convert.Reading("state", self._state), *refused)
                found = convert.Diagnosis(DRIVEN_ARM, convert.Level.ERROR, "no forecast", readings)
                ear.bus.publish(DIAGNOSTICS, convert.diagnostics_to_message(time.time_ns(), [found]))
                ear.step(0.1)

    def _on_acknowledge(self, _: object) -> None:
        self.acknowledged += 1
        if not self._refuses:
            self._state = "ready"


@pytest.mark.parametrize(
    ("state", "refuses", "status", "orders", "said"),
    [
        ("halted", False, 0, 1, "acknowledged what had halted: no forecast; now ready: no forecast"),
        ("halted", True, 1, 1, "still halted: no forecast; it still brakes"),
        ("ready", False, 0, 0, "no halt waits for somebody; ready: no forecast"),
    ],
)
def test_a_halt_of_a_launched_driver_is_acknowledged_by_a_command(
    graph: ZenohParameters,
    capsys: pytest.CaptureFixture[str],
    state: str,
    refuses: bool,
    status: int,
    orders: int,
    said: str,
) -> None:
    """Without ROS nothing on the graph could, and a launch had to be begun anew."""
    driver = HaltedDriver(graph.endpoint, state, refuses)
    driver.start()
    try:
        assert main(["acknowledge"]) == status
    finally:
        driver.ended.set()
        driver.join()
    captured = capsys.readouterr()
    assert (captured.out + captured.err).strip() == said
    assert driver.acknowledged == orders


def test_who_acknowledges_where_no_arm_is_driven_is_told(graph: ZenohParameters, refused: Callable[..., str]) -> None:
    assert "expected the driver of an arm on the graph of this machine" in refused("acknowledge")
