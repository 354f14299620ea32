"""Two machines whose link is slow and is cut: how soon the arm's machine notices, and that it goes on by itself.

The link is a relay between the zenoh routers of two machines on loopback: it delays every byte, and while it is cut it
forwards none. Lost packets are not imitated: zenoh's links are TCP, which sends them again.
"""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twin_node.bench.graph_run import GraphRun, free_endpoint
from twin_node.messages import convert
from twin_node.nodes.launch.launch_file import LaunchPlan, read_launch_file
from twin_node.nodes.topics import OBSTACLES, SEPARATION, kind_of
from twin_node.runtime.zenoh_session import ZenohParameters, open_router
from twin_node.runtime.zenoh_wire import ZenohWire
from twin_node.scene import Obstacles

RATE_HZ = 30.0
ARM_ALONE = """
launch:
  processes:
    arm: {nodes: [arm]}
/**:
  ros__parameters: {rig: {scenario: demo}}
arm:
  ros__parameters: {model: ur5e}
"""


@dataclass(frozen=True)
class NetworkFigures:
    """A link that delays and is cut, obstacles at 30 Hz; the deadline is the arm's `limiter.deadline_s` of 0.1 s."""

    delay_ms: float
    cut_s: float
    slow_after_s: float
    """From the cut until the arm was told to be slow, s."""
    stopped_after_s: float
    """From the cut until it was told to stand, s."""
    resumes_after_s: float
    """From the link's return until it was told to move, s."""
    out_of_order: int
    """Decisions whose evidence was older than that of one before."""


@dataclass(frozen=True)
class _Told:
    """A decision, when it was heard (monotonic, s), and the stamp of its evidence (ns)."""

    at: float
    fraction: float
    evidence: int


class Relay:
    """Forwards TCP connections with a delay, or not at all."""

    def __init__(self, target: str, delay_s: float) -> None:
        """`target`: zenoh endpoint tcp/HOST:PORT that connections lead to."""
        self._host, _, port = target.removeprefix("tcp/").rpartition(":")
        self._port = int(port)
        self._delay_s = delay_s
        self.is_cut = False
        self.endpoint = free_endpoint()
        self._loop = asyncio.new_event_loop()
        listening = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(listening,), name="relay", daemon=True)
        self._thread.start()
        listening.wait()

    def close(self) -> None:
        """Ends all connections."""
        self._loop.call_soon_threadsafe(self._end)
        self._thread.join()

    def _end(self) -> None:
        tasks = asyncio.all_tasks(self._loop)
        for task in tasks:
            task.cancel()
        ended = asyncio.gather(*tasks, return_exceptions=True)
        ended.add_done_callback(lambda _: self._loop.stop())

    def _run(self, listening: threading.Event) -> None:
        asyncio.set_event_loop(self._loop)
        host, _, port = self.endpoint.removeprefix("tcp/").rpartition(":")
        self._loop.run_until_complete(asyncio.start_server(self._connect, host, int(port)))
        listening.set()
        self._loop.run_forever()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection(self._host, self._port)
        with contextlib.suppress(asyncio.CancelledError):  # the relay is being closed
            await asyncio.gather(self._forward(reader, far_writer), self._forward(far_reader, writer))

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            due = self._loop.time() + self._delay_s
            while self.is_cut:
                await asyncio.sleep(0.005)
            await asyncio.sleep(max(0.0, due - self._loop.time()))
            writer.write(data)
        writer.close()


class _Twin:
    """Stands for the twin's machine: obstacles at a rate, from a router of its own."""

    def __init__(self) -> None:
        self.endpoint = free_endpoint()
        parameters = ZenohParameters(router="builtin", endpoint=self.endpoint, domain=0)
        self._router = open_router(parameters)
        self._wire = ZenohWire(replace(parameters, router="external"))
        self._send = self._wire.publisher("twin", OBSTACLES, kind_of(OBSTACLES))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="twin", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends it."""
        self._stop.set()
        self._thread.join()
        self._wire.close()
        if self._router is not None:
            self._router.close()

    def _run(self) -> None:
        while not self._stop.wait(1 / RATE_HZ):
            self._send(convert.obstacles_to_message(_nothing(time.time_ns())))


def network(delay_s: float = 0.02, cut_s: float = 3.0) -> NetworkFigures:
    """Lets the arm run, cuts the link, and mends it."""
    twin = _Twin()
    relay = Relay(twin.endpoint, delay_s)
    decisions: list[_Told] = []

    def hear(message: object) -> None:
        told = convert.separation_from_message(message)
        decisions.append(_Told(time.monotonic(), told.speed_fraction, told.evidence_stamp))

    with tempfile.TemporaryDirectory(prefix="twin_node_") as folder:
        run = GraphRun(_plan(Path(folder)), free_endpoint(), Path(folder), (relay.endpoint,))
        try:
            run.listen(SEPARATION, hear)
            run.wait_until(
                lambda: run.spin(0.1) or bool(decisions and decisions[-1].fraction > 0.9), "the arm did not move"
            )
            relay.is_cut = True
            cut = time.monotonic()
            run.spin(cut_s)
            relay.is_cut = False
            mended = time.monotonic()
            run.wait_until(lambda: run.spin(0.02) or decisions[-1].fraction > 0, "the arm did not go on")
        finally:
            run.close()
            relay.close()
            twin.close()
    evidence = [told.evidence for told in decisions if told.evidence]
    return NetworkFigures(
        delay_ms=1e3 * delay_s,
        cut_s=cut_s,
        slow_after_s=_first(decisions, cut, 0.2) - cut,
        stopped_after_s=_first(decisions, cut, 0.0) - cut,
        resumes_after_s=next(told.at for told in decisions if told.at > mended and told.fraction > 0) - mended,
        out_of_order=int((np.diff(evidence) < 0).sum()),
    )


def _first(decisions: list[_Told], since: float, fraction: float) -> float:
    return next((told.at for told in decisions if told.at > since and told.fraction <= fraction), float("nan"))


def _plan(folder: Path) -> LaunchPlan:
    path = folder / "arm.yaml"
    path.write_text(ARM_ALONE)
    return read_launch_file(path)


def _nothing(stamp: int) -> Obstacles:
    """No obstacle at all: the arm may run."""
    none = np.zeros(0)
    return Obstacles(
        stamp,
        none.astype(np.uint32),
        none.astype(np.uint8),
        none.astype(np.uint8),
        np.zeros((0, 3)),
        np.zeros((0, 4)),
        np.zeros((0, 3)),
        np.zeros((0, 3)),
        none,
        none.astype(np.int64),
        none.astype(np.int64),
    )
