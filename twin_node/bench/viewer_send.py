"""What a watched page costs the thread of the twin that sends: all visitors hang on one page, and that on the wire."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.bench.graph_run import free_endpoint
from twin_node.bench.visitors import PATIENCE_S, free_port, visiting
from twin_node.messages import Message, convert
from twin_node.nodes.playback import Playback
from twin_node.nodes.status import PER_SET
from twin_node.nodes.topics import GAUSSIANS, GAUSSIANS_MOVING, OBSTACLES, OCCUPANCY, kind_of_own
from twin_node.runtime.wire import Send
from twin_node.runtime.zenoh_session import ZenohParameters, close_session, open_router
from twin_node.runtime.zenoh_wire import ZenohWire

SETS = 150
"""Sent each way: 5 s of a camera rate of 30 Hz."""
PERIOD_S = 1 / 30


@dataclass(frozen=True)
class SendTimes:
    """Of sending what a twin says of one set of images, ms."""

    smallest: float
    median: float
    p99: float


@dataclass(frozen=True)
class SendCost:
    """The same messages sent 30 times a second, to nobody and to a page that is watched."""

    nobody: SendTimes
    watched: SendTimes
    median_cost_ms: float
    p99_cost_ms: float
    """Other work on the machine counts: the sending thread waits its turn too."""


def cost(messages: Mapping[str, Message], visitors: int) -> SendCost:
    """Sends what a twin says of a set, by topic, `SETS` times each way. Raises `BenchError` where no page comes."""
    parameters = ZenohParameters(router="builtin", endpoint=free_endpoint(), domain=0)
    with ExitStack() as stack:
        router = open_router(parameters)
        assert router is not None
        stack.callback(close_session, router)
        wire = ZenohWire(ZenohParameters(router="external", endpoint=parameters.endpoint, domain=0))
        stack.callback(wire.close)
        sends = {topic: wire.publisher("bench", topic, kind_of_own(topic)) for topic in PER_SET}
        nobody = _times(sends, messages)
        port = free_port()
        watching = stack.enter_context(visiting(port, visitors, range(0)))
        view = ("view", "--live", "--port", str(port), "--endpoint", parameters.endpoint)
        command = [sys.executable, "-c", "from twin_node.cli import main; main()", *view]
        page = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        stack.callback(page.wait)
        stack.callback(page.kill)
        for visitor in watching:
            visitor.wait()
        _wait_for_page(wire)
        watched = _times(sends, messages)
        if not all(visitor.sent().data for visitor in watching):
            raise BenchError("viewer: expected the page to show what is sent, found visitors who were sent nothing")
    return SendCost(nobody, watched, watched.median - nobody.median, watched.p99 - nobody.p99)


def middle_of(log: Path) -> Mapping[str, Message]:
    """What a twin said of the set in the middle of its log, by topic. Raises `GraphError` where it lacks a topic."""
    with Playback([log]) as playback:
        for topic in (GAUSSIANS, *PER_SET):
            playback.require(topic, "the bench")
        said = playback.at((playback.start_ns + playback.end_ns) // 2)
        obstacles = said.obstacles
        assert obstacles is not None
        own = {topic: said.said[topic].message for topic in (GAUSSIANS_MOVING, OCCUPANCY)}
        return {**own, OBSTACLES: convert.obstacles_to_message(obstacles)}  # of an older log in the types of today


def _times(sends: Mapping[str, Send], messages: Mapping[str, Message]) -> SendTimes:
    spent = []
    for _ in range(SETS):
        begun = time.perf_counter()
        for topic in PER_SET:
            sends[topic](messages[topic])
        spent.append(1e3 * (time.perf_counter() - begun))
        time.sleep(PERIOD_S)
    return SendTimes(min(spent), float(np.median(spent)), float(np.percentile(spent, 99)))


def _wait_for_page(wire: ZenohWire) -> None:
    """Until the page listens to what is sent."""
    until = time.monotonic() + PATIENCE_S
    while not any(end.topic == OBSTACLES and end.node.name == "viewer" for end in wire.endpoints()):
        if time.monotonic() > until:
            raise BenchError("viewer: expected the page to listen, found it silent; is the machine overloaded?")
        time.sleep(0.05)
