"""The unmodified clients of ur_rtde against the stand-in, each in the ways its users use it."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin_node import resources
from twin_node.cell.errors import CellError
from twin_node.cell.ur_sim import ControllerParameters, StandInParameters, StandInProcess, free_loopback
from twin_node.cell.ur_sim.rtde_wire import Kind, encode
from twin_node.cli import main

rtde_receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed (extra 'ur')")
rtde_io = pytest.importorskip("rtde_io", reason="ur_rtde is not installed (extra 'ur')")
rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed (extra 'ur')")
dashboard_client = pytest.importorskip("dashboard_client", reason="ur_rtde is not installed (extra 'ur')")

PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def process() -> Iterator[StandInProcess]:
    parameters = StandInParameters(host=free_loopback(), controller=ControllerParameters(unlock_delay_s=0.1))
    with StandInProcess(parameters) as running:
        yield running


@pytest.fixture
def stand_in(process: StandInProcess) -> StandInProcess:
    """The module's stand-in, begun anew."""
    process.switch("restart 0")
    eventually(lambda: process.status().event("fault: restart") is None and is_open(process.host))
    return process


class Clients:
    """The clients of ur_rtde that a test uses; left alone, they would connect again to the next test's controller."""

    def __init__(self, host: str) -> None:
        self._host = host
        self._made: list[Any] = []

    def receive(self, *arguments: object) -> Any:
        return self._keep(rtde_receive.RTDEReceiveInterface(self._host, *arguments))

    def io(self) -> Any:
        return self._keep(rtde_io.RTDEIOInterface(self._host))

    def control(self) -> Any:
        return self._keep(rtde_control.RTDEControlInterface(self._host))

    def dashboard(self) -> Any:
        client = self._keep(dashboard_client.DashboardClient(self._host))
        client.connect()
        return client

    def close(self) -> None:
        for client in reversed(self._made):
            client.disconnect()

    def _keep(self, client: Any) -> Any:
        self._made.append(client)
        return client


@pytest.fixture
def clients(stand_in: StandInProcess) -> Iterator[Clients]:
    made = Clients(stand_in.host)
    yield made
    made.close()


def eventually(holds: Callable[[], bool]) -> None:
    """Look again and again until something holds."""
    pause, looks = threading.Event(), round(PATIENCE_S / 0.01)
    if not any(holds() or pause.wait(0.01) for _ in range(looks)):
        pytest.fail(f"did not come true within {PATIENCE_S} s")


def is_open(host: str) -> bool:
    try:
        socket.create_connection((host, 30004)).close()
    except OSError:
        return False
    return True


def test_receive_tells_a_standing_arm_and_a_running_clock(stand_in: StandInProcess, clients: Clients) -> None:
    receive = clients.receive()
    assert (receive.getRobotMode(), receive.getSafetyMode(), receive.getRuntimeState()) == (7, 1, 1)
    np.testing.assert_allclose(receive.getActualQ(), stand_in.status().q, atol=1e-6)
    first = receive.getTimestamp()
    eventually(lambda: receive.getTimestamp() > first)
    assert not receive.isProtectiveStopped()
    receive.disconnect()


def test_slider_and_heartbeat_of_the_io_client_reach_the_program(stand_in: StandInProcess, clients: Clients) -> None:
    receive = clients.receive(125.0)
    io = clients.io()
    dashboard = clients.dashboard()
    assert io.setSpeedSlider(0.25)
    eventually(lambda: receive.getTargetSpeedFraction() == 0.25)
    dashboard.play()
    counts = iter(range(10**6))

    def is_moving() -> bool:
        io.setInputIntRegister(20, next(counts))
        return max(np.abs(receive.getActualQd())) > 0.02

    eventually(is_moving)
    assert dashboard.running()
    eventually(lambda: dashboard.programState().startswith("PAUSED"))  # nobody beats any more
    assert stand_in.status().event("program paused: watchdog") is not None


def test_the_control_client_moves_servos_stops_and_is_watched(stand_in: StandInProcess, clients: Clients) -> None:
    control = clients.control()
    receive = clients.receive()
    start = receive.getActualQ()
    goal = [start[0] + 0.2, *start[1:]]
    assert control.moveJ(goal, 1.5, 5.0)
    np.testing.assert_allclose(stand_in.status().q, goal, atol=2e-3)
    eventually(lambda: np.allclose(receive.getActualQ(), goal, atol=2e-3))  # its packages may wait for a busy machine
    assert control.moveJ(start, 0.5, 1.0, True)
    eventually(lambda: control.getAsyncOperationProgress() > 0)
    control.stopJ(5.0)
    assert control.isSteady()
    for _ in range(20):
        begun = control.initPeriod()
        assert control.servoJ(start, 0.0, 0.0, 0.002, 0.1, 300)
        control.waitPeriod(begun)
    assert control.servoStop()
    assert control.setWatchdog(10.0)
    eventually(lambda: not control.isProgramRunning())
    assert not control.servoJ(start, 0.0, 0.0, 0.002, 0.1, 300)
    assert control.reuploadScript()
    eventually(control.isProgramRunning)
    control.stopScript()
    eventually(lambda: stand_in.status().program is None)


def test_a_protective_stop_is_seen_by_all_and_unlocked(stand_in: StandInProcess, clients: Clients) -> None:
    control = clients.control()
    receive = clients.receive()
    dashboard = clients.dashboard()
    assert control.triggerProtectiveStop()
    eventually(receive.isProtectiveStopped)
    assert "PROTECTIVE_STOP" in dashboard.safetymode()
    assert not control.servoJ(receive.getActualQ(), 0.0, 0.0, 0.002, 0.1, 300)
    clock = stand_in.status().clock
    eventually(lambda: stand_in.status().clock > clock + 0.15)
    dashboard.unlockProtectiveStop()
    eventually(lambda: not receive.isProtectiveStopped())
    assert not control.isProgramRunning()
    dashboard.play()
    eventually(control.isProgramRunning)


def test_a_register_in_use_is_refused_as_a_real_controller_does(stand_in: StandInProcess, clients: Clients) -> None:
    stand_in.switch("claim speed_slider_mask")
    with pytest.raises(RuntimeError, match="in use"):
        clients.io()
    stand_in.switch("release speed_slider_mask")
    assert clients.io().setSpeedSlider(0.5)


def test_nan_and_five_joints_pass_through_ur_rtde_unnoticed(stand_in: StandInProcess, clients: Clients) -> None:
    names = ["timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode"]
    receive = clients.receive(125.0, names)
    stand_in.switch("nan")
    eventually(lambda: bool(np.isnan(receive.getActualQ()).all()))
    stand_in.switch("whole")
    eventually(lambda: bool(np.isfinite(receive.getActualQ()).all()))
    stand_in.switch("five")
    eventually(lambda: receive.getRobotMode() != 7)
    assert len(receive.getActualQ()) == 6
    stand_in.switch("whole")
    eventually(lambda: receive.getRobotMode() == 7)


def test_a_frozen_controller_keeps_its_connections(stand_in: StandInProcess, clients: Clients) -> None:
    receive = clients.receive()
    stand_in.switch("freeze")
    frozen = stand_in.status().clock
    told = receive.getTimestamp()
    assert receive.isConnected()
    assert stand_in.status().clock == frozen
    stand_in.switch("thaw")
    eventually(lambda: receive.getTimestamp() > told)
    stand_in.switch("drop")
    eventually(lambda: not receive.isConnected())
    assert receive.reconnect()


def test_a_cut_cable_lets_the_arm_go_on_and_no_byte_pass(stand_in: StandInProcess, clients: Clients) -> None:
    receive = clients.receive()
    stand_in.switch("cut")
    clock = stand_in.status().clock
    eventually(lambda: stand_in.status().clock > clock + 0.1)
    told = receive.getTimestamp()
    assert told < clock + 0.1
    stand_in.switch("join")
    eventually(lambda: receive.getTimestamp() > told)


def test_bytes_that_are_no_rtde_cost_only_their_own_connection(stand_in: StandInProcess, clients: Clients) -> None:
    receive = clients.receive()
    for junk in (
        b"GET / HTTP/1.1\r\n\r\n" * 2000,
        b"\x00\x00V",
        b"\x00\x04U\x09",
        b"\x00\x05O\x00\x00",
        b"\x00\x05I\xff\xff",
    ):
        with socket.create_connection((stand_in.host, 30004), timeout=PATIENCE_S) as connection:
            connection.sendall(junk)
            connection.shutdown(socket.SHUT_WR)
            with contextlib.suppress(ConnectionResetError):
                assert connection.recv(100) == b""
    told = receive.getTimestamp()
    eventually(lambda: receive.getTimestamp() > told)


def test_versions_of_the_protocol_that_it_does_not_speak_are_refused(stand_in: StandInProcess) -> None:
    """The first one was granted, and who spoke it dropped at its next package."""
    with socket.create_connection((stand_in.host, 30004), timeout=PATIENCE_S) as connection:
        for version, is_granted in ((1, False), (2, True), (3, False)):
            connection.sendall(encode(Kind.REQUEST_PROTOCOL_VERSION, struct.pack(">H", version)))
            assert connection.recv(100) == encode(Kind.REQUEST_PROTOCOL_VERSION, bytes([is_granted]))


def test_a_taken_address_is_named(stand_in: StandInProcess, refused: Callable[..., str]) -> None:
    with pytest.raises(CellError, match="is taken"):
        StandInProcess(StandInParameters(host=stand_in.host))
    assert "choose another loopback address" in refused("ur-sim", "--host", stand_in.host)


def test_the_command_says_where_it_is_and_ends_when_told() -> None:
    host = free_loopback()
    command = [sys.executable, "-c", "import sys; from twin_node.cli import main; sys.exit(main(sys.argv[1:]))"]
    with subprocess.Popen(
        [*command, "ur-sim", "--host", host, "--fault", "slow 2@0"], stdout=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        assert f"ur5e at {host}" in running.stdout.readline()
        assert is_open(host)
        os.kill(running.pid, signal.SIGTERM)
        assert running.wait(PATIENCE_S) == 0
    assert not is_open(host)


def test_the_help_says_what_it_does_not_do(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["ur-sim", "--help"])
    assert "interpret URScript" in capsys.readouterr().out
    assert main(["ur-sim", "--list-faults"]) == 0
    assert "freeze" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--host", "0.0.0.0"], "loopback"),
        (["--model", "kuka"], "ur3e"),
        (["--fault", "frieze"], "expected one of"),
        (["--fault", "freeze@-1"], "0 or more"),
        (["--fault", "freeze@soon"], "LINE@SECONDS"),
        (["--admin-port", "30004"], "--admin-port 30004: expected none of the controller's own ports"),
        (["--watchdog-variable", "heart"], "RTDE input"),
        (["--watchdog-hz", "1000"], "500 Hz"),
        (["--kinematics", "no_such_file.yaml"], "calibration file"),
    ],
)
def test_wrong_options_are_one_line_and_status_2(
    arguments: list[str], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ur-sim", "--host", free_loopback(), *arguments]) == 2
    err = capsys.readouterr().err
    assert word in err
    assert err.count("\n") == 1


def test_an_arm_of_more_joints_than_rtde_tells_of_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    """Its first period ended in a trace: `--model` takes files, too."""
    arm = resources.find("sim/ur5e.xml").read_text(encoding="utf-8")
    finger = '<body name="finger"><joint name="finger_joint" range="0 1"/><geom type="sphere" size="0.01"/></body>'
    at = arm.index("</body>")
    (tmp_path / "seven.xml").write_text(arm[:at] + finger + arm[at:])
    told = refused("ur-sim", "--host", free_loopback(), "--model", tmp_path / "seven.xml")
    assert "expected an arm of 6 joints, as RTDE tells of, found 7; choose one of ur3e" in told


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--polyscope", "5.99999999999.1"], "5.99999999999.1: expected a PolyScope 5 version"),
        (["--polyscope", "3.15.4"], "3.15.4: expected a PolyScope 5 version"),
        (["--admin-port", "65536"], "65536: expected a port, 1 to 65535, or 0 for none"),
        (["--admin-port", "\u00b2"], "expected a port, 1 to 65535, or 0 for none"),
        (["--admin-port", "9" * 5000], "expected a port, 1 to 65535, or 0 for none"),
    ],
    ids=["more than RTDE tells", "another generation", "beyond all ports", "a digit raised", "too long a number"],
)
def test_versions_and_ports_that_cannot_be_are_refused(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A client's request for a version that has no 32 bits ended its connection."""
    with pytest.raises(SystemExit):
        main(["ur-sim", *arguments])
    assert says in capsys.readouterr().err
