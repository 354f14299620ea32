"""What the way from one process to another costs by itself: images of a camera, obstacles and speed decisions."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.bench.graph_run import PATIENCE_S, Percentiles, free_endpoint, percentiles
from twin_node.messages import convert, header_stamp
from twin_node.nodes.topics import kind_of
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire_bus import WireBus
from twin_node.runtime.zenoh_session import ZenohParameters, close_session, open_router
from twin_node.runtime.zenoh_wire import ZenohWire
from twin_node.scene import JointSample

WIDTH, HEIGHT, RATE_HZ = 320, 240, 30.0
"""As the simulated cell's cameras."""
IMAGE, DEPTH, SMALL = "/back/image_raw", "/back/depth/image_rect", "/joint_states"
JOINTS = 6


@dataclass(frozen=True)
class HopFigures:
    """From a message's making to its callback in another process of the host, decoded; at 30 Hz over loopback."""

    image: Percentiles
    """Raw colour, 320x240."""
    depth: Percentiles
    """32FC1, 320x240, sent just before the colour image."""
    small: Percentiles
    """A hundred bytes, as a speed decision."""
    refused: int
    """Samples that came out of order."""


def hops(seconds: float) -> HopFigures:
    """Publishes here, and lets a process of its own listen. Raises `BenchError` where that hears nothing, or ends."""
    parameters = ZenohParameters(router="builtin", endpoint=free_endpoint(), domain=0)
    router = open_router(parameters)
    joined = replace(parameters, router="external")
    with ExitStack() as stack:
        if router is not None:
            stack.callback(close_session, router)
        here = stack.enter_context(_listening(joined))
        wire = ZenohWire(joined)
        stack.callback(wire.close)
        bus = WireBus(wire, Executor(), "bench", kind_of)
        _answer(here)
        makers = _makers()
        due, end = time.monotonic(), time.monotonic() + seconds
        while due < end:
            for topic, make in makers.items():
                bus.publish(topic, make(time.time_ns()))
            due += 1 / RATE_HZ
            time.sleep(max(0.0, due - time.monotonic()))
        delays, refused = _answer(here, asked=True)
    return HopFigures(percentiles(delays[IMAGE]), percentiles(delays[DEPTH]), percentiles(delays[SMALL]), refused)


@contextmanager
def _listening(parameters: ZenohParameters) -> Iterator[Connection]:
    """A pipe to a listening process, which does not outlive it."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    listener = context.Process(target=_listen, args=(parameters, there), name="listener")
    listener.start()
    there.close()  # or its end would not be heard
    try:
        yield here
    finally:
        listener.kill()
        listener.join()


def _answer(here: Connection, asked: bool = False) -> Any:
    """What the listening process says next, by itself or asked for what it heard. Raises `BenchError` without."""
    with suppress(EOFError, OSError):  # it has ended
        if asked:
            here.send(None)
        if here.poll(PATIENCE_S):
            return here.recv()
    raise BenchError("bench graph: expected the listening process to answer, found silence; is the machine overloaded?")


def _makers() -> dict[str, Callable[[int], Any]]:
    rgb = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    depth = np.ones((HEIGHT, WIDTH), np.float32)
    names = tuple(f"joint_{i}" for i in range(JOINTS))
    return {
        DEPTH: lambda stamp: convert.depth_image("back", stamp, depth),
        IMAGE: lambda stamp: convert.raw_image("back", stamp, rgb),
        SMALL: lambda stamp: convert.joint_sample_to_message(
            JointSample(stamp, names, np.zeros(JOINTS), np.zeros(JOINTS))
        ),
    }


def _listen(parameters: ZenohParameters, there: Connection) -> None:
    """The other process: takes note of delays, ms, until it is told to stop."""
    wire, executor = ZenohWire(parameters), Executor()
    bus = WireBus(wire, executor, "listener", kind_of)
    delays: dict[str, list[float]] = {IMAGE: [], DEPTH: [], SMALL: []}

    def hear(topic: str, message: Any) -> None:
        delays[topic].append((time.time_ns() - header_stamp(message)) / 1e6)

    for topic in delays:
        bus.subscribe(topic, partial(hear, topic))
    there.send(None)
    while not there.poll():
        executor.step(0.1)
    there.send((delays, wire.refused))
    wire.close()
