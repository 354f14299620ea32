"""A launcher among processes of the test's own: which it takes to have failed, and what it makes of them."""

from __future__ import annotations

import errno
import itertools
import os
import signal
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from twin_node.nodes.launch import launcher as launcher_module
from twin_node.nodes.launch.launch_file import read_launch_file
from twin_node.nodes.launch.launcher import FIRST_STATUS, HANGS_S, LOADS_S, RESTARTS_ALLOWED, STEP_S, Launcher
from twin_node.nodes.launch.order import Order
from twin_node.nodes.topics import GraphError
from twin_node.runtime.zenoh_session import ZenohParameters

ENOUGH = 20
"""Spares that no launcher is to begin."""


class Process:
    """Stands for a process: is configured as soon as it is told to be, and killed where the test says so."""

    def __init__(
        self, name: str, order: Order, log: Path, on_news: Callable[[], None], on_word: Callable[[str], None]
    ) -> None:
        self.name, self.pid, self.error, self.status = name, 0, None, None
        self.is_loaded = self.is_configured = self.is_active = self.has_pulsed = False
        self.silence_s = 0.0
        self._on_news = on_news
        self.has_begun()
        on_news()

    def has_begun(self) -> None:
        """For tests."""

    def configure(self) -> None:
        self.is_configured = True
        self._on_news()

    def activate(self) -> None:
        self.is_active = True
        self._on_news()

    def hear_out(self) -> None:
        """It says nothing."""

    stop = discard = hear_out

    def give_up(self) -> None:
        self.error, self.status = "it hung, and was ended", -signal.SIGKILL
        self._on_news()


class Looked(Process):
    """Is told, by `look`, each time that the launcher asks whether it has ended."""

    ended: int | None = None

    def look(self) -> None:
        """For tests."""

    @property
    def status(self) -> int | None:
        self.look()
        return self.ended

    @status.setter
    def status(self, value: int | None) -> None:
        self.ended = value


@pytest.fixture
def begin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Launcher]:
    """`begin(kind, say, processes)`: a launcher of a launch file's processes, which are of a kind."""
    monkeypatch.setattr(launcher_module, "open_router", lambda _: SimpleNamespace(close=lambda: None))
    names = SimpleNamespace(taken=lambda: None, close=lambda: None)
    monkeypatch.setattr(launcher_module, "NodeNames", lambda *_: names)

    def make(kind: type[Process], say: Callable[[str], None], processes: str) -> Launcher:
        monkeypatch.setattr(launcher_module, "Child", kind)
        (tmp_path / "test.yaml").write_text(f"launch: {{processes: {{{processes}}}}}")
        return Launcher(read_launch_file(tmp_path / "test.yaml"), tmp_path, say)

    return make


@pytest.mark.parametrize(
    ("processes", "alone"),
    [
        ("eyes: {nodes: [synchronizer]}, model: {nodes: [twin]}", "eyes.*'synchronizer'"),
        ("model: {nodes: [twin, arm]}", "model.*'twin'"),
    ],
)
def test_a_twin_apart_from_its_synchronizer_is_refused(
    begin: Callable[..., Launcher], processes: str, alone: str
) -> None:
    """It was active, and heard of no image: sets do not leave their process."""
    with pytest.raises(GraphError, match=f"process '{alone} without .*; write nodes: .synchronizer, twin."):
        begin(Process, print, processes).run()


def test_a_node_that_a_command_runs_is_not_said_to_be_of_a_launch(
    begin: Callable[..., Launcher], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside `twin_node record` a launch with a recorder told to end another launch, which nobody had begun."""
    monkeypatch.setattr(launcher_module, "open_router", lambda _: None)
    names = SimpleNamespace(taken=lambda: "recorder", close=lambda: None)
    monkeypatch.setattr(launcher_module, "NodeNames", lambda *_: names)
    with pytest.raises(
        GraphError, match=r"'recorder' is alive already .* by a command of its own \(record, .*; end that"
    ):
        begin(Process, print, "write: {nodes: [recorder]}").run()


def test_a_spare_that_dies_again_and_again_is_given_up_and_the_launch_goes_on(begin: Callable[..., Launcher]) -> None:
    begun: list[Process] = []

    class Dying(Process):
        def has_begun(self) -> None:
            begun.append(self)
            if len(begun) > 1:  # of one process all others are spares
                self.status = -signal.SIGKILL
            if len(begun) > ENOUGH:
                launcher.interrupt()

    said: list[str] = []

    def say(line: str) -> None:
        said.append(line)
        if "no spare" in line:
            launcher.interrupt()

    launcher = begin(Dying, say, "arm: {nodes: [arm], spare: true}")
    assert launcher.run().status == 0
    assert len(begun) == 1 + RESTARTS_ALLOWED + 1
    assert said == ["active: arm", "arm: no spare can be kept: the last was killed by signal 9"]


def test_the_exit_status_tells_the_place_in_the_file_whatever_was_left_out(begin: Callable[..., Launcher]) -> None:
    class Failing(Process):
        def activate(self) -> None:
            self.is_active, self.status = True, 1
            self._on_news()

    processes = "page: {nodes: [viewer], if: false}, arm: {nodes: [arm], restart: false}"
    assert begin(Failing, lambda line: None, processes).run().status == FIRST_STATUS + 1


def test_a_process_that_cannot_be_started_is_tried_again(begin: Callable[..., Launcher]) -> None:
    """Of a computer that has no room for another process just now: arm and twin went with it."""
    begun: list[Process] = []
    said: list[str] = []

    class Failing(Process):
        def has_begun(self) -> None:
            begun.append(self)
            if len(begun) == 2:
                raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

        def activate(self) -> None:
            self.is_active, self.status = True, 1 if len(begun) == 1 else None
            if len(begun) > 1:
                launcher.interrupt()
            self._on_news()

    launcher = begin(Failing, said.append, "arm: {nodes: [arm]}")
    assert launcher.run().status == 0
    assert len(begun) == 3
    assert "arm: cannot be started (Resource temporarily unavailable)" in said


def test_a_spare_that_cannot_be_started_is_gone_without(begin: Callable[..., Launcher]) -> None:
    said: list[str] = []

    class Only(Process):
        def has_begun(self) -> None:
            if said:
                raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    def say(line: str) -> None:
        said.append(line)
        if "no spare" in line:
            launcher.interrupt()

    launcher = begin(Only, say, "arm: {nodes: [arm], spare: true}")
    assert launcher.run().status == 0
    assert said[1:] == ["arm: no spare can be kept: Resource temporarily unavailable"]


def test_a_launch_whose_output_nobody_takes_goes_on(begin: Callable[..., Launcher]) -> None:
    """`launch > launch.log` on the disk that its recorder has filled: the word of it ended twin and arm."""
    begun: list[Process] = []

    class Failing(Process):
        def has_begun(self) -> None:
            begun.append(self)

        def activate(self) -> None:
            self.is_active, self.status = True, 1 if len(begun) == 1 else None
            if len(begun) > 1:
                launcher.interrupt()
            self._on_news()

    def say(line: str) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    launcher = begin(Failing, say, "arm: {nodes: [arm]}")
    assert launcher.run().restarts == 1


@pytest.mark.parametrize("stopped", ["the process", "the launcher", "both"])
def test_a_process_that_hangs_is_started_again(
    begin: Callable[..., Launcher], monkeypatch: pytest.MonkeyPatch, stopped: str
) -> None:
    begun: list[Process] = []
    now = [0.0]

    class Watched(Looked):
        """Has news until the launcher has looked often enough."""

        looks = 0

        def has_begun(self) -> None:
            begun.append(self)

        def look(self) -> None:
            if self.is_active and self.ended is None:
                self.looks += 1
                now[0] += 3600.0 if "launcher" in stopped or stopped == "both" else STEP_S
                self.has_pulsed = stopped == "the launcher" or self is not begun[0]
                if self.looks > 3 * HANGS_S / STEP_S or len(begun) > 1:
                    launcher.interrupt()
                self._on_news()

    monkeypatch.setattr(launcher_module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    said: list[str] = []
    launcher = begin(Watched, said.append, "arm: {nodes: [arm]}")
    assert launcher.run().status == 0
    hung = ["arm: failed: it hung, and was ended; starting it again"]
    assert said[1:] == ([] if stopped == "the launcher" else hung)
    assert begun[0].looks > HANGS_S / (2 * STEP_S)


@pytest.mark.parametrize(("takes_s", "restarts"), [(LOADS_S - 10, 0), (2 * LOADS_S, 1)])
def test_a_process_that_never_gets_ready_is_started_again(
    begin: Callable[..., Launcher], monkeypatch: pytest.MonkeyPatch, takes_s: float, restarts: int
) -> None:
    """One that only takes its time is not, nor for that time once it is ready."""
    begun: list[Process] = []
    now = [0.0]

    class Slow(Looked):
        def has_begun(self) -> None:
            begun.append(self)

        def configure(self) -> None:
            """It takes its time, but for the second."""

        def look(self) -> None:
            now[0] += STEP_S
            self.is_configured = now[0] > takes_s or self is not begun[0]
            if self.is_active:
                launcher.interrupt()
            self._on_news()

    monkeypatch.setattr(launcher_module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    said: list[str] = []
    launcher = begin(Slow, said.append, "arm: {nodes: [arm]}")
    assert launcher.run().restarts == restarts
    assert said == ["arm: failed: it hung, and was ended; starting it again"] * restarts + ["active: arm"]


@pytest.mark.parametrize("loads", [True, False])
def test_a_spare_that_never_loads_is_ended(
    begin: Callable[..., Launcher], monkeypatch: pytest.MonkeyPatch, loads: bool
) -> None:
    """No other process had a spare while it hung, and one that failed had it for its successor."""
    begun: list[Process] = []
    now = [0.0]

    class Loading(Looked):
        def has_begun(self) -> None:
            begun.append(self)
            self.is_loaded = loads or len(begun) == 1

        def look(self) -> None:
            if self is begun[0]:
                now[0] += STEP_S
                self.has_pulsed = True
                self._on_news()
                if now[0] > 2 * LOADS_S:
                    launcher.interrupt()

    monkeypatch.setattr(launcher_module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    said: list[str] = []
    launcher = begin(Loading, said.append, "arm: {nodes: [arm], spare: true}")
    assert launcher.run().restarts == 0
    hung = ["arm: no spare can be kept: it hung, and was ended"]
    assert said == ["active: arm", *([] if loads else hung)]
    assert len(begun) == 2 and begun[1].ended == (None if loads else -signal.SIGKILL)


@pytest.mark.parametrize(("lives_s", "waits_s"), [(7.0, [0] * 5 + [1, 2, 4, 8, 16, 32, 60, 60]), (700.0, [0] * 13)])
def test_a_process_that_fails_again_and_again_is_started_at_growing_intervals(
    begin: Callable[..., Launcher], monkeypatch: pytest.MonkeyPatch, lives_s: float, waits_s: list[float]
) -> None:
    """Never so often at once that the launch would end; one that was well in between has failed once."""
    began_s: list[float] = []
    now = [0.0]

    class Failing(Looked):
        def has_begun(self) -> None:
            began_s.append(now[0])
            if len(began_s) > len(waits_s):
                launcher.interrupt()

        def look(self) -> None:
            now[0] += 0.25
            self.has_pulsed = True
            self.ended = None if now[0] < began_s[-1] + lives_s else 1
            self._on_news()

    monkeypatch.setattr(launcher_module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    said: list[str] = []
    launcher = begin(Failing, said.append, "arm: {nodes: [arm]}")
    result = launcher.run()
    assert (result.status, result.restarts) == (0, len(waits_s))
    gaps = [after - before - lives_s for before, after in itertools.pairwise(began_s)]
    assert gaps == pytest.approx(waits_s, abs=2.0)
    told = [line for line in said if "it has failed" in line]
    assert len(told) == sum(wait > 0 for wait in waits_s)
    assert not told or told[1].endswith(
        "it has failed 7 times, each within 10 minutes of its start; starting it again in 2 s"
    )


def test_a_router_that_ends_with_another_command_is_replaced(
    begin: Callable[..., Launcher], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Router:
        info = SimpleNamespace(routers_zid=lambda: [])
        is_open = True

        def close(self) -> None:
            self.is_open = False

    tries: list[Router | None] = [None, None, Router()]
    left = list(tries)

    def open_router(_: ZenohParameters) -> Router | None:
        return left.pop(0)

    class Restless(Looked):
        """Has news until the launcher has looked for a router often enough."""

        def activate(self) -> None:
            self.is_active = True
            self._on_news()

        def look(self) -> None:
            if left:
                self._on_news()
            else:
                launcher.interrupt()

    said: list[str] = []
    launcher = begin(Restless, said.append, "arm: {nodes: [arm]}}, zenoh: {routers: [tcp/10.0.0.2:7447]")
    monkeypatch.setattr(launcher_module, "open_router", open_router)
    launcher.run()
    router = tries[-1]
    assert not left and router is not None and not router.is_open
    assert "need not be joined to tcp/10.0.0.2:7447" in said[0]
