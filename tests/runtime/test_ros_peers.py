"""Round trips with two other implementations of rmw_zenoh's format, and CDR and type hashes against theirs."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin_node.messages import definition, header, message_type, serialize, to_duration, type_hash
from twin_node.messages.services import service_type
from twin_node.runtime.executor import Executor
from twin_node.runtime.parameter_services import serve_parameters
from twin_node.runtime.parameter_values import parameters_of
from twin_node.runtime.qos import LATCHED, RELIABLE, TopicKind
from twin_node.runtime.services import ServiceClient
from twin_node.runtime.wire_bus import WireBus
from twin_node.runtime.zenoh_session import ZenohParameters
from twin_node.runtime.zenoh_wire import ZenohWire

PEERS = Path(__file__).parent / "peers"
COMPILED = Path(tempfile.gettempdir()) / "twin_node_tests_cydr"
"""Where pyzeros keeps the codecs that it compiles at first use: not optimised, in a third of the time."""
STRING, LAYER, JOINTS = "std_msgs/msg/String", "twin_msgs/msg/OccupancyLayer", "sensor_msgs/msg/JointState"
KINDS = {"/own_to_peer": LAYER, "/own_from_peer": LAYER, "/joints": JOINTS, "/joints_back": JOINTS}
ATTEMPTS = 600
"""Times that a message is sent until its echo comes; discovery takes a few, and on a busy machine a minute."""
LATE_JOINERS = 60
"""How many join, one after another, until one is given what is latched: each asks for it once."""

pytest.importorskip("zenoh")


def kind_of(topic: str) -> TopicKind:
    return TopicKind(KINDS.get(topic, STRING), LATCHED if topic == "/latched" else RELIABLE)


@dataclass
class Us:
    """Our side of a round trip."""

    wire: ZenohWire
    bus: WireBus
    executor: Executor
    port: int

    def exchange(self, topic: str, message: Any, answer_topic: str) -> Any:
        """Sends until an answer comes."""
        answers: list[Any] = []
        self.bus.subscribe(answer_topic, answers.append)
        for _ in range(ATTEMPTS):
            self.bus.publish(topic, message)
            self.executor.step(0.1)
            if answers:
                return answers[0]
        raise AssertionError(f"no answer on {answer_topic}")


@pytest.fixture
def us(zenoh_router: ZenohParameters) -> Iterator[Us]:
    wire, executor = ZenohWire(zenoh_router), Executor()
    port = int(zenoh_router.endpoint.rpartition(":")[2])
    yield Us(wire, WireBus(wire, executor, "twin", kind_of), executor, port)
    wire.close()


@pytest.fixture
def start_peer(tmp_path: Path) -> Iterator[Callable[..., None]]:
    """`start_peer(script, *arguments)`: runs a peer until the test ends; its input's end tells it to go."""
    running = []

    def start(script: str, *arguments: str) -> None:
        command = [sys.executable, str(PEERS / script), *arguments]
        pipe, quiet = subprocess.PIPE, subprocess.DEVNULL
        environment = {**os.environ, "CYDR_CACHE_DIR": str(COMPILED), "CFLAGS": "-O0"}
        peer = subprocess.Popen(command, cwd=tmp_path, env=environment, stdin=pipe, stdout=pipe, stderr=quiet)
        running.append(peer)
        assert peer.stdout is not None
        assert any(line == b"ready\n" for line in peer.stdout), "the peer did not start"

    yield start
    for peer in running:
        peer.communicate()


def need(package: str) -> None:
    if find_spec(package) is None:
        pytest.skip(f"the peer {package} is not installed (extra 'interop')")


def test_messages_go_both_ways_with_zenoh_ros2_sdk(us: Us, start_peer: Callable[..., None]) -> None:
    need("zenoh_ros2_sdk")
    string = message_type(STRING)
    us.bus.publish("/latched", string(data="map"))
    start_peer("sdk_echo.py", str(us.port), definition(LAYER), type_hash(LAYER))
    answers: set[str] = set()
    us.bus.subscribe("/from_peer", lambda answer: answers.add(answer.data))
    for _ in range(LATE_JOINERS):
        us.bus.publish("/to_peer", string(data="hello"))
        while us.executor.step(1.0):
            if answers == {"echo hello", "kept map"}:  # in either order
                return
    raise AssertionError(f"expected an echo, and for the late joiner the latched message, found {answers}")


def test_services_are_asked_and_answered_with_zenoh_ros2_sdk(
    us: Us, zenoh_router: ZenohParameters, start_peer: Callable[..., None]
) -> None:
    need("zenoh_ros2_sdk")
    kind = service_type("rcl_interfaces/srv/GetParameterTypes")
    serve_parameters(us.wire, "twin", parameters_of({"on": True, "width": 640}))
    told: list[str] = []
    us.bus.subscribe("/from_peer", lambda message: told.append(message.data))
    start_peer("sdk_services.py", str(us.port), kind.type_hash)
    with contextlib.closing(ServiceClient(zenoh_router)) as client:
        for _ in range(ATTEMPTS):
            answer = client.ask("/peer/get_parameter_types", kind, 1.0, names=["a", "three"])
            us.executor.step(0.1)
            if answer is not None and "types [1, 2]" in told:
                break
        assert answer is not None, "the peer did not answer"
        assert answer.types.tolist() == [1, 5]
        assert "types [1, 2]" in told, "the peer was not answered"


def test_our_own_messages_go_both_ways_with_zenoh_ros2_sdk(us: Us, start_peer: Callable[..., None]) -> None:
    need("zenoh_ros2_sdk")
    start_peer("sdk_echo.py", str(us.port), definition(LAYER), type_hash(LAYER))
    sent = message_type(LAYER)(
        horizon=to_duration(200_000_000),
        indices=np.array([3, 5, 8], dtype=np.uint32),
        probability=np.array([255, 128, 1], dtype=np.uint8),
    )
    back = us.exchange("/own_to_peer", sent, "/own_from_peer")
    assert bytes(serialize(back)) == bytes(serialize(sent))


def test_messages_go_both_ways_with_pyzeros(us: Us, start_peer: Callable[..., None]) -> None:
    need("pyzeros")
    start_peer("pyzeros_echo.py", str(us.port))
    assert us.exchange("/to_peer", message_type(STRING)(data="hello"), "/from_peer").data == "echo hello"
    sent = message_type(JOINTS)(
        header=header(1_500_000_000, "base_link"),
        name=["shoulder", "elbow"],
        position=np.array([0.25, -1.5]),
        velocity=np.array([0.0, 2.0]),
        effort=np.array([], dtype=np.float64),
    )
    back = us.exchange("/joints", sent, "/joints_back")
    assert bytes(serialize(back)) == bytes(serialize(sent))
