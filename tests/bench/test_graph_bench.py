"""The graph's bench: its link loses packets and can be cut, its images are readable, killed recorders leave files."""

from __future__ import annotations

import dataclasses
import json
import math
import multiprocessing
import re
import select
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from twin_node.bag import BagError
from twin_node.bench import graph_hops, graph_recorder
from twin_node.bench.errors import BenchError
from twin_node.bench.graph import IdleFigures, KillFigures, LatencyFigures
from twin_node.bench.graph_cameras import CameraFigures, FaultFigures
from twin_node.bench.graph_hops import HopFigures, hops
from twin_node.bench.graph_link import Link, Machine
from twin_node.bench.graph_live import LiveFigures
from twin_node.bench.graph_machine import Told
from twin_node.bench.graph_network import Cut, NetworkFigures, figures_of
from twin_node.bench.graph_recorder import HEIGHT, WIDTH, KilledFigures, RecorderFigures, images, killed
from twin_node.bench.graph_run import Percentiles, percentiles
from twin_node.bench.graph_table import Figures, table
from twin_node.cli import main
from twin_node.json_text import json_text
from twin_node.messages import convert

SEND = """
import socket
s = socket.create_server(('10.77.0.1', 5))
print("listens", flush=True)
c = s.accept()[0]
c.sendall(b'x' * 300000)
c.recv(1)
"""
TAKE = """
import socket, sys
c = socket.create_connection(('10.77.0.1', 5), timeout=60)
size = 0
while size < 300000:
    size += len(c.recv(65536))
print(size, flush=True)
sys.stdin.read()
"""


def test_a_link_between_machines_loses_packets_and_no_bytes() -> None:
    """The kernel's TCP sends again what the link has lost; while it is cut nothing comes."""
    try:
        near, far = Machine("10.77.0.1/24"), Machine("10.77.0.2/24")
    except BenchError as error:
        pytest.skip(str(error))
    link = Link(near, far, 0.001, loss=0.05)
    link.is_cut = True
    listens = near.start([sys.executable, "-c", SEND]).stdout
    assert listens is not None and listens.readline() == "listens\n"
    output = far.start([sys.executable, "-c", TAKE]).stdout
    assert output is not None
    assert not select.select([output], [], [], 0.3)[0]
    link.is_cut = False
    assert output.readline() == "300000\n"
    for machine in (far, near):
        machine.end()
    link.close()
    for machine in (near, far):
        machine.close()


def told(at_ms: int, fraction: float, evidence: int) -> Told:
    return Told(at_ms * 1e-3, fraction, evidence)


def test_silence_counts_from_the_last_message_that_arrived() -> None:
    heard = [told(33 * i, 1.0, 1 + i) for i in range(20)]
    last = 33 * 19
    heard += [told(last + 95, 0.2, 20), told(last + 145, 0.2, 20), told(last + 195, 0.0, 20)]
    heard += [told(last + 2000, 0.0, 21), told(last + 2033, 0.01, 22)]
    cut = Cut(0.0, (last - 10) * 1e-3, (last + 1500) * 1e-3)
    found = figures_of(heard, [cut])
    assert (found.slow_after_s, found.stopped_after_s) == (pytest.approx(0.095), pytest.approx(0.195))
    assert found.resumes_after_s == pytest.approx(0.533)
    assert (found.out_of_order, found.slow_share) == (0, 0.0)


def test_the_share_in_which_loss_keeps_an_arm_slow_is_one_of_time() -> None:
    """Of ten decisions three are of a silence that lasts for half the time."""
    heard = [told(100 * i, 1.0, 1 + i) for i in range(4)] + [told(at, 0.2, 4) for at in (400, 600, 800)]
    heard += [told(900 + 33 * i, 1.0, 5 + i) for i in range(3)] + [told(2000, 0.2, 8), told(3000, 1.0, 9)]
    found = figures_of(heard, [Cut(-0.001, 0.999, 2.5)])
    assert found.slow_share == pytest.approx(0.5)


def test_an_arm_that_is_never_stopped_is_not_hidden_by_one_that_is() -> None:
    heard = [told(33 * i, 1.0, 1 + i) for i in range(30)]
    heard += [told(1100, 0.2, 30), told(1200, 0.0, 30), told(3000, 0.5, 31), told(3033, 1.0, 32)]
    heard += [told(4100, 1.0, 33), told(4900, 1.0, 34)]
    cuts = [Cut(0.0, 0.96, 2.9), Cut(3.0, 3.5, 4.8)]
    for ordered in (cuts, cuts[::-1]):
        found = figures_of(heard, ordered)
        assert found.stopped_after_s == found.slow_after_s == math.inf
    assert '"stopped_after_s": null' in json_text(dataclasses.asdict(found))


def test_silence_is_no_latency() -> None:
    with pytest.raises(BenchError, match="heard none"):
        percentiles([])
    assert percentiles([1.0]).p99 == 1.0


def test_a_recorders_file_that_does_not_open_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def damaged(path: Path) -> None:
        raise BagError(f"{path}: damaged")

    monkeypatch.setattr(graph_recorder, "open_log", damaged)
    with pytest.raises(BenchError, match="files that open, found none of 1"):
        killed(1, tmp_path)


def test_the_images_that_are_recorded_are_images() -> None:
    for topic, message in images():
        decoded = message.decode()
        if "depth" in topic:
            assert convert.depth_from_message(decoded).shape == (HEIGHT, WIDTH)
        else:
            assert convert.rgb_from_message(decoded).shape == (HEIGHT, WIDTH, 3)


def test_a_killed_recorder_leaves_a_file_that_opens(tmp_path: Path) -> None:
    figures = killed(1, tmp_path)
    assert (figures.kills, figures.opened) == (1, 1)


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_an_interrupted_bench_leaves_no_recorder_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would fill the disk, and the command would wait for it for ever."""
    monkeypatch.setattr(time, "sleep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        killed(1, tmp_path)
    assert multiprocessing.active_children() == []


def ready_and_gone(parameters: object, there: Connection) -> None:
    there.send(None)


def test_a_listener_that_ends_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph_hops, "_listen", ready_and_gone)
    with pytest.raises(BenchError, match="expected the listening process to answer"):
        hops(0.01)


def test_an_interrupted_bench_leaves_no_listener_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph_hops, "PATIENCE_S", 5.0)
    monkeypatch.setattr(graph_hops, "_makers", interrupted)
    with pytest.raises(KeyboardInterrupt):
        hops(1.0)
    assert multiprocessing.active_children() == []


def test_a_part_that_is_named_twice_is_measured_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = []

    def measure(seconds: float) -> HopFigures:
        measured.append(seconds)
        return HopFigures(*[Percentiles(1, 1.0, 1.0, 1.0)] * 3, 0)

    monkeypatch.setattr(graph_hops, "hops", measure)
    assert main(["bench", "graph", "--only", "hops", "hops", "--seconds", "3"]) == 0
    assert measured == [3.0]
    assert capsys.readouterr().out.splitlines() == [
        "hops: from process to process  p50 ms  p99 ms  least ms  messages",
        "  image                           1.0     1.0       1.0         1",
        "  depth                           1.0     1.0       1.0         1",
        "  small message                   1.0     1.0       1.0         1",
        "  came out of order: 0",
    ]


PARTS: dict[str, Figures] = {
    "latency": LatencyFigures(Percentiles(9, 177.0, 250.0, 100.0), Percentiles(8, 288.0, 301.0, 99.0), -111.0, -51.0),
    "idle": IdleFigures(0.022, (("arm", 0.012), ("arm, spare", 0.01))),
    "kills": KillFigures(20, 1.32, 0.27, (("cell", 0.3), ("twin", 0.2)), 7.5, 1.5, 0, 0),
    "recorder": RecorderFigures(300.0, 54006, 54005, 1, 26.04, 0.06),
    "killed": KilledFigures(20, 20, 0.174),
    "network": NetworkFigures(20.0, 0.01, 3.0, 3, math.inf, 0.21, 0.096, 0.194, 1.2, 0, 0.024, 23.4, 33.2),
    "live": LiveFigures(90.0, 18.4, Percentiles(900, 97.0, 210.0, 48.0), 0.22, 0.27, math.inf, 0.0),
    "cameras": CameraFigures(10.0, 0, (FaultFigures("dead", math.nan, 7.5, 0.94, 0),)),
}


def test_every_part_is_told_in_lines_that_fit_a_terminal() -> None:
    told = {part: table(part, figures).splitlines() for part, figures in PARTS.items()}
    for part, lines in told.items():
        assert lines[0].startswith(f"{part}: ")
        assert max(map(len, lines)) <= 100
        assert not re.search(r"[{}()']|nan|inf|\d{3}\.\d{2}", "".join(lines).replace("link's", "")), lines
    assert [line.split()[-1] for line in told["idle"]] == ["%"] * 3
    assert told["latency"][-1].split()[-2:] == ["-111.0", "-51.0"]
    assert told["kills"][1].split()[-2:] == ["0.27", "1.32"]
    assert told["recorder"][1].split()[1:] == ["54006", "54005", "1", "26.0", "6.0", "%"]
    assert told["network"][2].split()[-2:] == ["0.10", "never"]  # the median, and the longest
    assert told["live"][-2] == "  nearest to somebody meanwhile: it did not move, or nobody was there"
    assert told["cameras"][-1].split() == ["dead", "never", "0.94", "7.5", "0"]


def test_a_part_that_fails_is_one_line_and_the_others_are_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(seconds: float) -> HopFigures:
        raise BenchError("no listener")

    monkeypatch.setattr(graph_hops, "hops", refuse)
    monkeypatch.setattr(graph_recorder, "killed", lambda times, folder: PARTS["killed"])
    assert main(["bench", "graph", "--only", "hops", "killed", "--json"]) == 1
    told = capsys.readouterr()
    assert json.loads(told.out)["hops"] == {"error": "no listener"}
    assert json.loads(told.out)["killed"]["opened"] == 20
    assert told.err.splitlines() == ["hops: no listener", *table("killed", PARTS["killed"]).splitlines()]
