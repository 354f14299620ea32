"""`record`, `play`, `info`, `check` and `doctor` as a user runs them, with zenoh's own configuration files."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import numpy as np
import pytest

from twin_node.arm.ur import DriverReport, DriverState
from twin_node.bag import LogWriter, RecordingWriter, open_log
from twin_node.bench.visitors import BYTES_PER_SPLAT, Visitor, free_port
from twin_node.cell.scenario import Fault
from twin_node.cli import main
from twin_node.cli.ur_driver import _News
from twin_node.messages import builtin_types, convert, message_type, serialize
from twin_node.model.ply import StoredGaussians, cloud_from_stored
from twin_node.nodes.topics import DIAGNOSTICS, GAUSSIANS
from twin_node.runtime.zenoh_session import ZenohParameters

PATIENCE_S = 60.0


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Environment whose zenoh files lead to a port of the test's own."""
    pytest.importorskip("zenoh")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    common = "scouting: {multicast: {enabled: false}}, timestamping: {enabled: true}"
    session, router = tmp_path / "session.json5", tmp_path / "router.json5"
    own = "listen: {endpoints: ['tcp/127.0.0.1:0']}"  # zenoh tells nobody of loopback where it listens everywhere
    session.write_text(f"{{mode: 'peer', connect: {{endpoints: ['{endpoint}']}}, {own}, {common}}}")
    router.write_text(f"{{mode: 'router', listen: {{endpoints: ['{endpoint}']}}, {common}}}")
    files = {"ZENOH_SESSION_CONFIG_URI": str(session), "ZENOH_ROUTER_CONFIG_URI": str(router)}
    return {**os.environ, **files, "ROS_DOMAIN_ID": "7"}


@pytest.mark.parametrize(
    "command",
    [
        ["record", "-o", "run.mcap"],
        ["play", "LOG"],
        ["doctor"],
        ["view", "--live"],
        ["ur-driver", "--robot", "127.0.0.77"],
    ],
)
def test_a_port_that_another_program_holds_is_told(
    command: list[str],
    cell_log: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A recorder recorded nothing, a player played to nobody and ended well, doctor found no graph."""
    pytest.importorskip("zenoh")
    monkeypatch.chdir(tmp_path)
    with HTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as taken:
        threading.Thread(target=taken.serve_forever, daemon=True).start()
        endpoint = f"tcp/127.0.0.1:{taken.server_port}"
        monkeypatch.setattr("twin_node.nodes.live.single.ZenohParameters", partial(ZenohParameters, endpoint=endpoint))
        assert main([str(cell_log(0.3)) if word == "LOG" else word for word in command]) == 2
        taken.shutdown()
    assert f"{endpoint}: expected a zenoh router there" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


@pytest.fixture
def start(environment: dict[str, str]) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """`start(*arguments)`: a `twin_node` process, ended with the test."""
    running: list[subprocess.Popen[str]] = []

    def begin(*arguments: str, **more: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", "import sys; from twin_node.cli import main; sys.exit(main())", *arguments]
        process = subprocess.Popen(command, env={**environment, **more}, stdout=subprocess.PIPE, text=True)
        running.append(process)
        return process

    yield begin
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()


def small_log(path: Path) -> Path:
    string = message_type("std_msgs/msg/String")
    with RecordingWriter(path) as log:
        for i in range(20):
            log.write(
                "/chatter",
                "std_msgs/msg/String",
                bytes(serialize(string(data=str(i)))),
                i * 50_000_000,
                builtin_types(),
            )
    return path


def wait_for_messages(folder: Path, recorder: subprocess.Popen[str]) -> None:
    """Until a recording holds something."""
    until = time.monotonic() + PATIENCE_S
    file = folder / f"{folder.name}_0.mcap"
    while time.monotonic() < until:
        if file.exists() and b"/chatter" in file.read_bytes():
            return
        with contextlib.suppress(subprocess.TimeoutExpired):
            recorder.wait(0.2)
    raise AssertionError("nothing was recorded")


def test_what_is_played_is_recorded(tmp_path: Path, start: Callable[..., subprocess.Popen[str]]) -> None:
    log, out = small_log(tmp_path / "small.mcap"), tmp_path / "out"
    recorder = start("record", "--all", "-o", str(out))
    assert recorder.stdout is not None and recorder.stdout.readline().startswith("recording into")
    player = start("play", str(log), "--loop", "--rate", "2")
    wait_for_messages(out, recorder)
    for process in (player, recorder):
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    with open_log(out) as written, open_log(log) as read:
        assert written.damage is None
        known = {bytes(m.data) for m in read.messages()}
        heard = [bytes(m.data) for m in written.messages(["/chatter"])]
    assert heard
    assert set(heard) <= known


def test_a_recording_can_be_ended_by_whoever_leads_the_graph(
    tmp_path: Path, start: Callable[..., subprocess.Popen[str]]
) -> None:
    """A node that lives as long as its command says what it is set to, and ends in order; it does nothing else."""
    recorder = start("record", "--all", "-o", str(tmp_path / "out"))
    assert recorder.stdout is not None and recorder.stdout.readline().startswith("recording into")

    def said(*arguments: str) -> str:
        asked = start(*arguments)
        said, _ = asked.communicate(timeout=PATIENCE_S)
        return said.strip()

    until = time.monotonic() + PATIENCE_S
    while said("lifecycle", "get", "recorder") != "active" and time.monotonic() < until:
        time.sleep(0.1)
    assert said("param", "get", "recorder", "output") == str(tmp_path / "out")
    assert said("lifecycle", "set", "recorder", "deactivate") == ""
    assert said("lifecycle", "get", "recorder") == "active"
    assert said("lifecycle", "set", "recorder", "shutdown") == "/recorder: finalized"
    assert recorder.wait(PATIENCE_S) == 0
    assert (tmp_path / "out" / "metadata.yaml").exists(), "it ended in order"


def test_a_recording_without_its_folder_is_refused_before_it_is_announced(
    tmp_path: Path, start: Callable[..., subprocess.Popen[str]]
) -> None:
    recorder = start("record", "--all", "-o", str(tmp_path / "nosuch" / "out.mcap"))
    assert recorder.wait(PATIENCE_S) == 2
    assert recorder.stdout is not None and "recording into" not in recorder.stdout.read()


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_what_a_driver_said_until_it_was_ended_is_kept(
    tmp_path: Path, start: Callable[..., subprocess.Popen[str]], ending: signal.Signals
) -> None:
    """Ctrl-C is how a driver ends; no controller is needed for it to say something."""
    pytest.importorskip("rtde_io", reason="ur_rtde is not installed")
    out = tmp_path / "driver.mcap"
    driver = start("ur-driver", "--robot", "127.0.0.77", "-o", str(out))
    assert driver.stdout is not None
    while not (line := driver.stdout.readline()).startswith("lost: 127.0.0.77"):
        assert line, "the driver has ended"
    driver.send_signal(ending)
    assert driver.wait(PATIENCE_S) == 0
    assert list(tmp_path.glob("*.partial")) == []
    with open_log(out) as log:
        assert [topic.name for topic in log.topics] == [DIAGNOSTICS]


SPLATS = 10_000
"""More than the page's first message holds of anything else, the arm's links too."""


def splat_log(path: Path) -> Path:
    """Ten thousand Gaussians, said ten times a second."""
    rng = np.random.default_rng(0)
    stored = StoredGaussians(
        rng.normal(size=(SPLATS, 3)).astype(np.float32),
        rng.normal(size=(SPLATS, 4)).astype(np.float32),
        np.full((SPLATS, 3), -4, np.float32),
        np.zeros(SPLATS, np.float32),
        np.zeros((SPLATS, 1, 3), np.float32),
    )
    with LogWriter(path) as log:
        for i in range(20):
            stamp = 10**18 + i * 100_000_000
            log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_from_stored(stored), stamp), stamp)
    return path


def test_a_visitor_of_the_live_viewer_sees_what_is_played(
    tmp_path: Path, start: Callable[..., subprocess.Popen[str]]
) -> None:
    """The log's own time is told; the page ends when it is asked to, with status 0."""
    pytest.importorskip("viser")
    port = free_port()
    page = start("view", "--live", "--port", str(port))
    player = start("play", str(splat_log(tmp_path / "splats.mcap")), "--loop", "--clock")
    visitor = Visitor(port, range(SPLATS * BYTES_PER_SPLAT, 10**9))
    try:
        visitor.wait()
        assert page.stdout is not None and page.stdout.readline() == f"http://127.0.0.1:{port}\n"
        assert visitor.sent(updates=1).updates == 1  # what stands is sent once
    finally:
        visitor.end()
    for process in (player, page):
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0


def test_info_and_check_of_a_sound_log(cell_log: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(cell_log(1.2)), "--json"]) == 0
    held = json.loads(capsys.readouterr().out)
    assert held["damage"] is None
    assert {"/tf_static", "/joint_states"} <= {topic["name"] for topic in held["topics"]}
    assert main(["check", str(cell_log(1.2))]) == 0
    assert "sound" in capsys.readouterr().out


def test_check_names_what_is_wrong(cell_log: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    faults = (
        Fault("missing", "cam_left", 0.4, 0.8),
        Fault("nan_depth", "cam_back", 0.0, 9.0),
        Fault("unsorted_stamps", "cam_front", 0.0, 9.0),
    )
    assert main(["check", str(cell_log(1.2, *faults)), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    said = {topic["name"]: " ".join(topic["faults"]) for topic in found["topics"]}
    assert "1 gap," in said["/cam_left/image_raw/compressed"]
    assert said["/cam_back/depth/image_rect"] == "no depth is known in any image that was looked at"
    assert "run backwards" in said["/cam_front/image_raw/compressed"]
    assert said["/joint_states"] == ""


def test_check_tells_degrees_from_radians_and_missing_calibration(
    tmp_path: Path, cell_log: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    with open_log(cell_log(1.2)) as log, RecordingWriter(tmp_path / "odd.mcap") as odd:
        for message in log.messages():
            if message.topic == "/tf_static":
                continue
            data = message.data
            if message.topic == "/joint_states":
                content = message.message
                content.position = content.position * 57.3
                data = bytes(serialize(content))
            odd.write(message.topic, message.msgtype, data, message.stamp, message.types)
    assert main(["check", str(tmp_path / "odd.mcap")]) == 1
    said = capsys.readouterr().out
    assert "are they degrees?" in said
    assert "no transforms join it to base_link" in said


def test_doctor_says_that_nobody_is_there(
    environment: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("ZENOH_SESSION_CONFIG_URI", "ZENOH_ROUTER_CONFIG_URI", "ROS_DOMAIN_ID"):
        monkeypatch.setenv(name, environment[name])
    assert main(["doctor", "--seconds", "0.1"]) == 1
    assert "found: nobody is there" in capsys.readouterr().out


def test_a_driver_says_whole_reasons_once() -> None:
    """It said "ready: slow" of an arm that is slow for somebody, and "controller sent 9.3 rad/s" without the joint."""
    news = _News()
    reasons = (
        "slow for MOVING",
        "slow for MOVING",
        "slow for UNKNOWN",
        "stopped: no forecast for 141 ms",
        "stopped: no forecast for 1615 ms",
        "controller sent 9.30 rad/s for wrist_1_joint: beyond its rating",
    )
    said = [news.of(DriverReport(0, DriverState.READY, reason)) for reason in reasons]
    assert said == [None if row in (1, 4) else f"ready: {reason}" for row, reason in enumerate(reasons)]


def test_a_player_that_nobody_could_let_go_on_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert "--start-paused: expected a terminal" in refused("play", small_log(tmp_path / "log.mcap"), "--start-paused")
