"""The graph's bench: its relay forwards and can be cut, its images are readable, killed recorders leave files."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from twin_node.bench.graph_network import Relay
from twin_node.bench.graph_recorder import HEIGHT, WIDTH, images, killed
from twin_node.messages import convert


def test_a_relay_forwards_unless_it_is_cut() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        relay = Relay(f"tcp/127.0.0.1:{server.getsockname()[1]}", 0.001)
        host, _, port = relay.endpoint.removeprefix("tcp/").rpartition(":")
        with socket.create_connection((host, int(port))) as near, server.accept()[0] as far:
            near.sendall(b"there")
            assert far.recv(16) == b"there"
            far.sendall(b"and back")
            assert near.recv(16) == b"and back"
            relay.is_cut = True
            near.sendall(b"held")
            far.settimeout(0.05)
            with pytest.raises(TimeoutError):
                far.recv(16)
            relay.is_cut = False
            far.settimeout(60)
            assert far.recv(16) == b"held"
        relay.close()


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
