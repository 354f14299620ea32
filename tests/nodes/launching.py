"""Launches for tests: on a router of their own, with an ear on a topic, and brought down whatever happens."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from twin_node.nodes.launch.launch_file import LaunchPlan
from twin_node.nodes.launch.launcher import Launcher, LaunchResult
from twin_node.nodes.topics import kind_of
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire_bus import WireBus
from twin_node.runtime.zenoh_session import ZenohParameters
from twin_node.runtime.zenoh_wire import ZenohWire

PATIENCE_S = 90.0
"""How long a test waits for what must come; far more than it takes on a busy machine."""


def on_loopback(plan: LaunchPlan, endpoint: str) -> LaunchPlan:
    """The plan with a router of its own."""
    return replace(plan, zenoh=replace(plan.zenoh, router="builtin", endpoint=endpoint, domain=0))


def without_spares(plan: LaunchPlan) -> LaunchPlan:
    """The plan for tests in which nothing is to take over: a spare costs as much as what it stands by for."""
    return replace(plan, processes=tuple(replace(process, has_spare=False) for process in plan.processes))


class Running:
    """A launch under way."""

    def __init__(self, plan: LaunchPlan, logs: Path) -> None:
        self.said: list[str] = []
        self.launcher = Launcher(plan, logs, self.said.append)
        self.result: LaunchResult | None = None
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        try:
            self.result = self.launcher.run()
        except BaseException as error:
            self.error = error

    def wait(self) -> LaunchResult:
        """The result, when it has ended by itself."""
        self._thread.join(PATIENCE_S)
        if self.error is not None:
            raise self.error
        assert self.result is not None, "the launch did not end"
        return self.result

    def stop(self) -> LaunchResult:
        """Interrupts it."""
        self.launcher.interrupt()
        return self.wait()


@contextlib.contextmanager
def launched(plan: LaunchPlan, logs: Path) -> Iterator[Running]:
    """A launch that is brought down at the end."""
    running = Running(plan, logs)
    try:
        yield running
    finally:
        running.launcher.interrupt()
        running._thread.join()


class Ear:
    """Listens to a graph from outside, as another process."""

    def __init__(self, endpoint: str) -> None:
        self._wire = ZenohWire(ZenohParameters(router="external", endpoint=endpoint, domain=0))
        self._executor = Executor()
        self.bus = WireBus(self._wire, self._executor, "ear", kind_of)

    def hear(self, topic: str, wanted: Callable[[Any], bool]) -> Any:
        """The next message on `topic` that is wanted."""
        heard: list[Any] = []
        self.bus.subscribe(topic, lambda message: heard.append(message) if wanted(message) else None)
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            self._executor.step(0.5)
            if heard:
                return heard[0]
        raise AssertionError(f"nothing that was wanted came on {topic}")

    def step(self, seconds: float) -> None:
        """Listens for so long."""
        until = time.monotonic() + seconds
        while (left_s := until - time.monotonic()) > 0:
            self._executor.step(left_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        """A connection that stays open when a test fails would keep the test run from ending."""
        self._wire.close()
