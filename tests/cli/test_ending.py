"""A command that is told to end does so in order, whoever tells it."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from importlib.machinery import ExtensionFileLoader
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from twin_node import cli
from twin_node.bag import LogWriter
from twin_node.cli import launch, view
from twin_node.cli.ending import SIGNALS, Terminated, ended_in_order
from twin_node.messages import message_type
from twin_node.nodes.launch.launcher import LaunchResult


@pytest.fixture(autouse=True)
def unhandled() -> Iterator[None]:
    """The tests themselves may run under `nohup`, or behind a shell's `&`, which have them ignore some."""
    at_start = {**dict.fromkeys(SIGNALS, signal.SIG_DFL), signal.SIGINT: signal.default_int_handler}
    before = {number: signal.signal(number, handler) for number, handler in at_start.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_nothing_half_written_is_left_and_handlers_are_as_before(
    number: signal.Signals, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by `timeout`, systemd, or a terminal that was closed: a NAME.partial would keep the next run from writing."""

    def write(_options: object) -> None:
        with LogWriter(tmp_path / "log.mcap"):
            assert list(tmp_path.iterdir())
            signal.raise_signal(number)

    monkeypatch.setattr("twin_node.cli.logs._info", write)
    before = signal.getsignal(number)
    assert cli.main(["info", "log.mcap"]) == status
    assert signal.getsignal(number) is before
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_what_a_signal_has_made_fail_is_no_failure(
    number: signal.Signals, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of MuJoCo, whose loading turns what a handler raises into an ImportError."""

    def load(_options: object) -> None:
        try:
            signal.raise_signal(number)
        except BaseException as error:
            raise ImportError("initialization failed") from error

    monkeypatch.setattr("twin_node.cli.logs._info", load)
    assert cli.main(["info", "log.mcap"]) == status


def test_an_ignored_signal_stays_ignored() -> None:
    """As `nohup` has it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_in_order():
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_page_ends_though_what_loads_has_swallowed_the_signal() -> None:
    def swallowing(is_interrupted: Callable[[], bool]) -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        except Terminated:
            assert is_interrupted()

    with pytest.raises(Terminated), ended_in_order(), view._interrupts() as is_interrupted:
        swallowing(is_interrupted)


@pytest.mark.parametrize("loader", [ExtensionFileLoader("swallowing", "swallowing.so"), None])
def test_an_interrupt_that_comes_while_a_compiled_module_loads_is_raised_after_it(
    loader: ExtensionFileLoader | None,
) -> None:
    """NumPy and torch load parts of themselves from C: what was raised there was gone, and the command went on.

    Of torch's, which the bodies of plain modules (None) set up, it aborted the process.
    """

    source = """
import signal
try:
    signal.raise_signal(signal.SIGINT)
except BaseException:
    pass
loaded = True
"""
    module = ModuleType("swallowing")
    in_import = compile("def exec_module(self, module): exec(source, module.__dict__)", "<frozen importlib._x>", "exec")
    space: dict[str, Any] = {"source": source}
    exec(in_import, space)
    with pytest.raises(KeyboardInterrupt), ended_in_order():
        space["exec_module"](loader, module)
        threading.Event().wait(60)
    assert module.loaded
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@pytest.mark.parametrize(("arguments", "status"), [(["--version"], 0), (["info", "not_there.mcap"], 2)])
def test_streams_that_were_closed_are_no_failure(
    arguments: list[str], status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by `>&- 2>&-`, or a service manager: Python has no streams then."""
    monkeypatch.setattr("sys.stdout", None)
    monkeypatch.setattr("sys.stderr", None)
    if status:
        assert cli.main(arguments) == status
    else:
        with pytest.raises(SystemExit) as ended:
            cli.main(arguments)
        assert ended.value.code == status


def test_output_of_a_closed_stream_goes_nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.stdout", None)
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/a", message_type("std_msgs/msg/String")(data="a"), 0)
    assert cli.main(["info", str(tmp_path / "log.mcap")]) == 0


def test_nobody_presses_enter_at_a_closed_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    """As by `<&-`: `play` and `ur-driver`, which look there for Enter, ended in a trace, the latter while it drove."""
    looked: list[str] = []
    monkeypatch.setattr("sys.stdin", None)
    monkeypatch.setattr("twin_node.cli.logs._info", lambda _options: looked.append(sys.stdin.readline()))
    assert cli.main(["info", "log.mcap"]) == 0
    assert looked == [""]
    assert not sys.stdin.isatty()


@pytest.mark.parametrize(("before", "interrupts"), [(signal.SIG_DFL, 2), (signal.SIG_IGN, 0)])
def test_a_launch_whose_terminal_is_closed_is_brought_down_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: signal.Handlers, interrupts: int
) -> None:
    """Shell and terminal tell of it, twice: the second one had ended the launcher, and its processes all at once."""
    told: list[int] = []

    class Hung:
        def __init__(self, *_: object) -> None:
            """It has a terminal."""

        def interrupt(self) -> None:
            told.append(1)

        def run(self) -> LaunchResult:
            for _ in range(2):
                signal.raise_signal(signal.SIGHUP)
            return LaunchResult()

    monkeypatch.setattr("twin_node.nodes.launch.launcher.Launcher", Hung)
    handled = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    signal.signal(signal.SIGHUP, before)
    try:
        with ended_in_order():
            assert launch._run(SimpleNamespace(path=Path("cell.yaml")), tmp_path) == 0
    finally:
        for number, handler in handled.items():
            signal.signal(number, handler)
    assert len(told) == interrupts
