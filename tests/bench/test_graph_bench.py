"""The graph's bench: its link loses packets and can be cut, its images are readable, killed recorders leave files."""

from __future__ import annotations

import select
import sys
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from twin_node.bench.errors import BenchError
from twin_node.bench.graph_link import Link, Machine
from twin_node.bench.graph_machine import Told
from twin_node.bench.graph_network import Cut, figures_of
from twin_node.bench.graph_recorder import HEIGHT, WIDTH, images, killed
from twin_node.messages import convert

SEND = (
    "import socket; s = socket.create_server(('10.77.0.1', 5)); c = s.accept()[0]; c.sendall(b'x' * 300000); c.recv(1)"
)
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
    near.start([sys.executable, "-c", SEND])
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
    found = figures_of(heard, [cut], 0.02, 0.01)
    assert (found.slow_after_s, found.stopped_after_s) == (pytest.approx(0.095), pytest.approx(0.195))
    assert found.resumes_after_s == pytest.approx(0.533)
    assert (found.out_of_order, found.slow_share) == (0, 0.0)


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
