"""The UR driver as a node and as a command, against the stand-in through the unmodified ur_rtde."""

from __future__ import annotations

import errno
import signal
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from twin_node.arm import LimiterParameters, extrapolate
from twin_node.arm.ur import DriverMode, DriverReport, DriverState, Halt, UrParameters
from twin_node.arm.ur.sample import UrSample
from twin_node.bag import LogWriter, open_log
from twin_node.bench.graph_run import free_endpoint
from twin_node.cell.ur_sim import StandInParameters, StandInProcess, free_loopback
from twin_node.cli import main
from twin_node.messages import convert, header_stamp
from twin_node.messages.types import message_type
from twin_node.nodes.topics import ACKNOWLEDGE, DIAGNOSTICS, FOLLOW, JOINT_STATES, SEPARATION, TRAJECTORY
from twin_node.nodes.ur_driver import UrDriverNode, driven_model
from twin_node.robot import ur_model
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import PacedClock, SteppedClock
from twin_node.runtime.zenoh_session import ZenohParameters
from twin_node.scene import Float64, JointPath, Separation

pytest.importorskip("rtde_io", reason="ur_rtde is not installed (extra 'ur')")
pytest.importorskip("zenoh")

PATIENCE_S = 60.0
START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def stand_in() -> Iterator[StandInProcess]:
    with StandInProcess(StandInParameters(host=free_loopback())) as running:
        yield running


@pytest.fixture(autouse=True)
def own_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands join a graph of the test's own, in which nobody else drives an arm."""
    own = partial(ZenohParameters, endpoint=free_endpoint(), domain=0)
    monkeypatch.setattr("twin_node.nodes.live.single.ZenohParameters", own)


class Graph:
    """A bus with the driver on it; time is that of a log."""

    def __init__(self, host: str, mode: DriverMode) -> None:
        self.bus, self.clock = LocalBus(), PacedClock(START_NS, 1.0)
        self.clock.start()
        self.heard: dict[str, list[Any]] = {topic: [] for topic in (JOINT_STATES, TRAJECTORY, DIAGNOSTICS)}
        for topic, messages in self.heard.items():
            self.bus.subscribe(topic, messages.append)
        limits = LimiterParameters(deadline_s=2.0, rise_per_s=20.0)
        self.node = UrDriverNode(self.bus, self.clock, UrParameters(robot=host, mode=mode, stale_s=0.5, limiter=limits))
        self.node.configure()
        self.node.activate()

    def until(self, holds: Callable[[], bool], fraction: float = 1.0) -> None:
        """Tick and decide until something holds."""
        pause = threading.Event()
        last = time.monotonic() + PATIENCE_S
        while not holds():
            assert time.monotonic() < last, self.node.report
            now = self.clock.now()
            told = Separation.without_pair(now, now - 30_000_000, fraction, "clear")
            self.bus.publish(SEPARATION, convert.separation_to_message(told))
            self.node.tick()
            pause.wait(0.02)

    def is_in(self, state: DriverState) -> bool:
        return self.node.report is not None and self.node.report.state is state

    def acknowledge(self) -> None:
        """What somebody does who waits for the arm; while it has no connection, that is not heard."""
        self.bus.publish(ACKNOWLEDGE, message_type("std_msgs/msg/Empty")())

    def close(self) -> None:
        self.node.deactivate()
        self.node.cleanup()


def test_decisions_of_the_graph_become_slider_and_the_arm_becomes_topics(stand_in: StandInProcess) -> None:
    graph = Graph(stand_in.host, DriverMode.SLIDER)
    graph.until(lambda: stand_in.status().speed_slider == pytest.approx(0.4), fraction=0.4)
    stand_in.dashboard("play")
    graph.until(lambda: np.abs(graph.heard[JOINT_STATES][-1].velocity).max() > 0.05, fraction=0.4)
    sample = convert.joint_sample_from_message(graph.heard[JOINT_STATES][-1])
    assert sample.names == ur_model("ur5e").joint_names
    assert abs(sample.stamp - graph.clock.now()) < PATIENCE_S * 1e9  # the graph's time, not this computer's
    path = convert.joint_path_from_message(graph.heard[TRAJECTORY][-1], 0)
    assert path.stamps[-1] - path.stamps[0] == 200_000_000
    travelled = np.abs(path.positions[-1] - path.positions[0]).max()
    assert travelled > 1.5 * 0.2 * np.abs(sample.velocities).max()  # told at full speed, though it runs at 0.4
    stand_in.switch("drop")
    graph.until(lambda: graph.is_in(DriverState.HALTED))
    levels = [convert.diagnostics_from_message(message)[0].level for message in graph.heard[DIAGNOSTICS]]
    assert convert.Level.OK in levels
    assert {driven_model(message) for message in graph.heard[DIAGNOSTICS]} == {"ur5e"}
    graph.until(lambda: convert.diagnostics_from_message(graph.heard[DIAGNOSTICS][-1])[0].level is convert.Level.ERROR)
    graph.until(lambda: graph.acknowledge() or graph.is_in(DriverState.READY))
    graph.close()
    assert stand_in.status().speed_slider == 0.0
    assert graph.node.report is None


def test_servo_mode_follows_what_the_graph_asks_for(stand_in: StandInProcess) -> None:
    stand_in.dashboard("stop")  # a program of the robot's own is not ended for it
    graph = Graph(stand_in.host, DriverMode.SERVO)
    graph.until(lambda: graph.node.report is not None and graph.node.report.speed_fraction == 1.0)
    start = np.array(stand_in.status().q)
    goal = start + np.array([0.2, 0, 0, 0, 0, 0])
    stamps = np.arange(11, dtype=np.int64) * 50_000_000 + graph.clock.now()
    way = np.linspace(0, 1, 11)[:, None]
    path = JointPath(ur_model("ur5e").joint_names, stamps, start + way * (goal - start))
    graph.bus.publish(FOLLOW, convert.joint_path_to_message(path))
    graph.until(lambda: np.abs(np.array(stand_in.status().q) - goal).max() < 1e-3)
    graph.close()


def test_a_trajectory_without_points_ends_the_one_that_is_followed(stand_in: StandInProcess) -> None:
    """As ROS's trajectory controllers are told to stay where they are."""
    graph = Graph(stand_in.host, DriverMode.SERVO)
    graph.until(lambda: graph.node.report is not None and graph.node.report.speed_fraction == 1.0)
    start = np.array(stand_in.status().q)
    names = ur_model("ur5e").joint_names

    def trajectory(way: float, seconds: int) -> Any:
        ends = start, start + np.array([way, 0, 0, 0, 0, 0])
        stamps = graph.clock.now() + np.array([0, seconds * 1_000_000_000])
        return convert.joint_path_to_message(JointPath(names, stamps, np.array(ends)))

    message = trajectory(0.6, 60)
    graph.bus.publish(FOLLOW, message)
    graph.until(lambda: stand_in.status().q[0] > start[0] + 1e-3)
    message.points = []
    graph.bus.publish(FOLLOW, message)

    def ahead() -> Float64:
        return convert.joint_path_from_message(graph.heard[TRAJECTORY][-1], 0).positions

    graph.until(lambda: np.ptp(ahead(), axis=0).max() == 0)
    assert stand_in.status().q[0] < start[0] + 0.3
    assert graph.node.report is not None
    assert (graph.node.report.state, graph.node.report.refusal) == (DriverState.READY, None)
    start = ahead()[-1]
    graph.bus.publish(FOLLOW, trajectory(-0.1, 1))
    graph.until(lambda: abs(stand_in.status().q[0] - (start[0] - 0.1)) < 1e-3)
    graph.close()


def test_the_command_records_what_it_reads(stand_in: StandInProcess, tmp_path: Path) -> None:
    out = tmp_path / "arm.mcap"
    arguments = ["ur-driver", "--robot", stand_in.host, "--mode", "read-only", "-o", str(out), "--duration", "3"]
    assert main(arguments) == 0
    with open_log(out) as log:
        assert {DIAGNOSTICS} <= {topic.name for topic in log.topics}


def test_what_was_recorded_until_the_link_was_lost_is_kept(
    stand_in: StandInProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, ticks, tick = tmp_path / "arm.mcap", [0], UrDriverNode.tick

    def tick_and_drop(node: UrDriverNode) -> None:
        tick(node)
        ticks[0] += node.report is not None and node.report.sample is not None
        if ticks[0] == 5:
            stand_in.switch("drop")

    monkeypatch.setattr(UrDriverNode, "tick", tick_and_drop)
    arguments = ["ur-driver", "--robot", stand_in.host, "--mode", "read-only", "--no-reconnect", "-o", str(out)]
    assert main(arguments) == 2
    assert "connection lost" in capsys.readouterr().err
    with open_log(out) as log:
        assert {DIAGNOSTICS, JOINT_STATES} <= {topic.name for topic in log.topics}


def test_a_full_disk_costs_neither_the_driver_nor_what_was_recorded_by_then(
    stand_in: StandInProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All of it was thrown away, and nobody told before the driver was ended."""
    out, add_message, ticks, tick = tmp_path / "arm.mcap", Writer.add_message, [0, 0], UrDriverNode.tick

    def refuse(writer: Writer, *given: Any) -> None:
        ticks[0] += 1
        if ticks[0] > 60:
            raise OSError(errno.ENOSPC, "No space left on device")
        add_message(writer, *given)

    def tick_on(node: UrDriverNode) -> None:
        tick(node)
        ticks[1] += ticks[0] > 60

    monkeypatch.setattr(Writer, "add_message", refuse)
    monkeypatch.setattr(UrDriverNode, "tick", tick_on)
    arguments = ["ur-driver", "--robot", stand_in.host, "--mode", "read-only", "-o", str(out), "--duration", "4"]
    assert main(arguments) == 2
    told = f"{out}: cannot be written on (No space left on device); what was recorded until then can be read"
    said = capsys.readouterr()
    assert said.out.count(f"not recorded any more: {told}") == 1
    assert told in said.err
    assert ticks[1] > 10
    with open_log(out) as log:
        assert sum(topic.count for topic in log.topics) == 60


def test_a_terminal_that_is_closed_does_not_cost_the_recording(
    stand_in: StandInProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shell and terminal tell of it, twice: the second one had ended the driver at once, and the log in a record."""
    out, ticks, tick = tmp_path / "arm.mcap", [0], UrDriverNode.tick

    def tick_and_hang_up(node: UrDriverNode) -> None:
        tick(node)
        ticks[0] += 1
        if ticks[0] == 5:
            for _ in range(2):
                signal.raise_signal(signal.SIGHUP)

    monkeypatch.setattr(UrDriverNode, "tick", tick_and_hang_up)
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        assert main(["ur-driver", "--robot", stand_in.host, "--mode", "read-only", "-o", str(out)]) == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    with open_log(out) as log:
        assert log.damage is None


def test_a_second_interrupt_does_not_cost_the_recording(
    stand_in: StandInProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who presses Ctrl-C twice, as `timeout -s INT` does, lost all of it."""
    out, deactivate = tmp_path / "arm.mcap", UrDriverNode.deactivate

    def deactivate_and_interrupt(node: UrDriverNode) -> None:
        deactivate(node)
        raise KeyboardInterrupt

    monkeypatch.setattr(UrDriverNode, "deactivate", deactivate_and_interrupt)
    arguments = ["ur-driver", "--robot", stand_in.host, "--mode", "read-only", "--duration", "2", "-o", str(out)]
    assert main(arguments) == 130
    with open_log(out) as log:
        assert {DIAGNOSTICS} <= {topic.name for topic in log.topics}
    assert list(tmp_path.iterdir()) == [out]


def test_a_recording_of_an_arm_that_never_was_there_is_not_kept(tmp_path: Path) -> None:
    out = tmp_path / "arm.mcap"
    assert main(["ur-driver", "--robot", free_loopback(), "--no-reconnect", "-o", str(out)]) == 2
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_recording_of_an_arm_is_never_written_over(
    stand_in: StandInProcess, tmp_path: Path, refused: Callable[..., str]
) -> None:
    out = tmp_path / "arm.mcap"
    out.write_bytes(b"a shift")
    arguments = ["ur-driver", "--robot", stand_in.host, "--mode", "read-only", "-o", str(out), "--duration", "0.1"]
    assert f"-o {out}: exists already" in refused(*arguments)
    assert out.read_bytes() == b"a shift"
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "expected a UR controller on port 30004"),
        (["--model", "kuka"], "ur3e"),
        (["--register", "30"], "18 to 22"),
        (["--kinematics", "none.yaml"], "calibration file"),
        (["--decisions", "none.mcap"], "none.mcap"),
    ],
)
def test_what_cannot_be_driven_is_one_line_and_status_2(
    arguments: list[str], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ur-driver", "--robot", free_loopback(), "--no-reconnect", *arguments]) == 2
    error = capsys.readouterr().err
    assert word in error
    assert error.count("\n") == 1


def test_a_log_without_decisions_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    log = tmp_path / "joints.mcap"
    with LogWriter(log) as writer:
        model = ur_model("ur5e")
        path = JointPath(model.joint_names, np.array([START_NS]), np.zeros((1, 6)))
        writer.write(TRAJECTORY, convert.joint_path_to_message(path), START_NS)
    assert "expected a log with /twin/separation" in refused(
        "ur-driver", "--robot", free_loopback(), "--no-reconnect", "--decisions", log
    )


def test_diagnostics_go_on_when_the_computers_clock_is_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """As it is when a network time server is first reached: once a second is by the clock that nobody sets."""
    bus, clock, heard, passed_s = LocalBus(), SteppedClock(START_NS), [], [100.0]
    bus.subscribe(DIAGNOSTICS, heard.append)
    monkeypatch.setattr(time, "monotonic_ns", lambda: round(passed_s[0] * 1e9))
    node = UrDriverNode(bus, clock, UrParameters())
    report = DriverReport(0, DriverState.HALTED, "safety mode PROTECTIVE_STOP")
    monkeypatch.setattr(node, "_driver", SimpleNamespace(latest=report))
    node.tick()
    assert len(heard) == 1
    node.clock = SteppedClock(START_NS - 3_600_000_000_000)
    for _ in range(4):
        passed_s[0] += 0.5
        node.tick()
    assert len(heard) == 3


def test_an_arm_is_told_of_from_when_the_graphs_time_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before `/clock` comes, and in a simulator's first moments, stamps were negative, which ended the node."""
    bus, heard, model = LocalBus(), [], ur_model("ur5e")
    for topic in (JOINT_STATES, TRAJECTORY):
        bus.subscribe(topic, heard.append)
    monkeypatch.setattr(time, "monotonic_ns", lambda: 10**12)
    node = UrDriverNode(bus, SteppedClock(0), UrParameters())
    rest = np.zeros(6)
    sample = UrSample(1.0, rest, rest, rest, rest, 7, 1, 2, 1.0, 1.0)
    for since_ns in (20_000_000, 10_000_000):
        report = DriverReport(
            10**12 - since_ns,
            DriverState.READY,
            "clear",
            sample=sample,
            sample_stamp=10**12 - since_ns,
            future=extrapolate(model, rest, rest, 10**12 - since_ns),
        )
        monkeypatch.setattr(node, "_driver", SimpleNamespace(latest=report))
        node.tick()
        assert len(heard) == (0 if since_ns == 20_000_000 else 2)
        node.clock = SteppedClock(15_000_000)
    assert [header_stamp(message) for message in heard] == [5_000_000, 5_000_000]


def test_who_launched_the_driver_is_told_why_the_arm_stands_and_when_it_may_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """A launch said nothing of a halt that waited for somebody, or of a controller that was not there."""
    said: list[str] = []
    node = UrDriverNode(LocalBus(), SteppedClock(START_NS), UrParameters(), said.append)
    halt = Halt("no forecast")
    reports = [
        (0, DriverReport(0, DriverState.CONNECTING, "connecting")),
        (1, DriverReport(0, DriverState.LOST, "no controller")),  # it may be about to begin
        (3, DriverReport(0, DriverState.CONNECTING, "connecting")),
        (5, DriverReport(0, DriverState.LOST, "no controller")),
        (6, DriverReport(0, DriverState.LOST, "no controller")),
        (7, DriverReport(0, DriverState.READY, "stopped: no forecast yet")),
        (8, DriverReport(0, DriverState.READY, "clear")),
        (9, DriverReport(0, DriverState.HALTED, "stopped: no forecast for 141 ms", halt=halt)),
        (10, DriverReport(0, DriverState.HALTED, "stopped: no forecast for 161 ms", halt=halt)),
        (11, DriverReport(0, DriverState.LOST, "connection lost")),
        (12, DriverReport(0, DriverState.READY, "clear")),
    ]
    for passed_s, report in reports:
        monkeypatch.setattr(time, "monotonic_ns", lambda passed_s=passed_s: passed_s * 1_000_000_000)
        monkeypatch.setattr(node, "_driver", SimpleNamespace(latest=report))
        node.tick()
    halted = "halted: stopped: no forecast for 141 ms; it waits for 'twin_node acknowledge'"
    assert said == ["lost: no controller", "ready again", halted, "ready again"]
