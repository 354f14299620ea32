"""A launch under measurement: on a router of its own, with an ear on its topics."""

from __future__ import annotations

import contextlib
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from twin_node.bench.errors import BenchError
from twin_node.bench.visitors import free_port
from twin_node.nodes.launch.launch_file import LaunchPlan
from twin_node.nodes.launch.launcher import Launcher
from twin_node.nodes.topics import kind_of
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire_bus import WireBus
from twin_node.runtime.zenoh_session import ZenohParameters
from twin_node.runtime.zenoh_wire import ZenohWire

PATIENCE_S = 120.0
"""How long anything may take to come on a busy machine, s."""


def free_endpoint() -> str:
    """An address of loopback that nobody listens on."""
    return f"tcp/127.0.0.1:{free_port()}"


@dataclass(frozen=True)
class Percentiles:
    """Of a sample of latencies, ms."""

    count: int
    p50: float
    p99: float
    smallest: float


class GraphRun:
    """A launch under way, listened to by this process."""

    def __init__(self, plan: LaunchPlan, endpoint: str, logs: Path, routers: tuple[str, ...] = ()) -> None:
        """`endpoint`: where its router listens; `routers`: other machines' routers that it is joined to."""
        zenoh = ZenohParameters(router="builtin", endpoint=endpoint, routers=routers, domain=0)
        self.launcher = Launcher(replace(plan, zenoh=zenoh), logs, lambda line: None)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="launcher", daemon=True)
        self._thread.start()
        try:
            self.wait_until(lambda: self.launcher.is_active, "the launch did not become active")
            self._wire = ZenohWire(replace(zenoh, router="external"))
        except BaseException:  # raised again: the launch's processes would run on
            self._end()
            raise
        self.executor = Executor()
        self.bus = WireBus(self._wire, self.executor, "bench", kind_of)

    def listen(self, topic: str, callback: Callable[[Any], None]) -> None:
        """Call `callback(message)` for messages on `topic`, while this run spins."""
        self.bus.subscribe(topic, callback)

    def spin(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Listens for so long, or until `until()`; whether that came true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if until():
                return True
            self.executor.step(min(0.05, max(0.0, end - time.monotonic())))
        return until()

    def wait_until(self, condition: Callable[[], bool], complaint: str) -> None:
        """Waits for a condition; raises `BenchError` where it does not come true."""
        end = time.monotonic() + PATIENCE_S
        pause = threading.Event()
        while not condition():
            if self._error is not None:
                raise self._error
            if time.monotonic() > end:
                raise BenchError(f"bench graph: {complaint} within {PATIENCE_S:.0f} s; is the machine overloaded?")
            pause.wait(0.005)

    def close(self) -> None:
        """Brings the launch down."""
        self._wire.close()
        self._end()

    def _end(self) -> None:
        self.launcher.interrupt()
        self._thread.join()

    def _run(self) -> None:
        try:
            self.launcher.run()
        except BaseException as error:  # raised again in the measuring thread
            self._error = error


@contextlib.contextmanager
def running(plan: LaunchPlan) -> Iterator[GraphRun]:
    """A launch that is brought down at the end."""
    with tempfile.TemporaryDirectory(prefix="twin_node_") as folder:
        run = GraphRun(plan, free_endpoint(), Path(folder))
        try:
            yield run
        finally:
            run.close()


def cpu_s(pid: int) -> float:
    """Processor time of a process, s."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def percentiles(samples: Sequence[float]) -> Percentiles:
    """Of latencies in ms. Raises `BenchError` without any."""
    if not samples:
        raise BenchError("bench graph: expected messages to time, heard none; is the machine overloaded?")
    return Percentiles(
        len(samples), float(np.percentile(samples, 50)), float(np.percentile(samples, 99)), float(min(samples))
    )
