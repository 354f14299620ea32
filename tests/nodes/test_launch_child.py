"""A process of a launch as its launcher sees it: that its end is known before its last words."""

from __future__ import annotations

import io
import json
import os
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from twin_node.nodes.launch import child as child_module
from twin_node.nodes.launch.child import Child
from twin_node.nodes.launch.host import REFUSED
from twin_node.nodes.launch.order import Order

WAIT_S = 60.0


@pytest.mark.parametrize("log", ["gone/twin.log", "file/twin.log"])
def test_a_process_is_started_where_its_log_cannot_be_kept(tmp_path: Path, log: str) -> None:
    """Somebody has cleared the logs away, or their disk is read-only by now: the graph needs its process anew."""
    (tmp_path / "file").touch()
    said: list[str] = []
    order = Order(("recorder",), {"recorder": {"otput": "run"}}, False, False, {}, {}, "test.yaml")
    child = Child("twin", order, tmp_path / log, lambda: None, said.append)
    child.hear_out()
    child._process.wait(WAIT_S)
    assert child.status == REFUSED
    assert (tmp_path / log).exists() or "no log is kept" in said[0]


def test_a_process_gives_way_as_it_is_told_to_and_has_the_launcher_s_session(tmp_path: Path) -> None:
    """Linux shares processors among sessions first: in one of its own, a process gives way to nobody of the launch."""
    loaded = threading.Event()
    sections = {"recorder": {"output": str(tmp_path / "run")}}
    order = Order(("recorder",), sections, False, False, {}, {}, "test.yaml", niceness=3)
    child = Child("recorder", order, tmp_path / "log", loaded.set, lambda line: None)
    try:
        assert loaded.wait(WAIT_S)
        assert child.is_loaded, child.error  # one that was refused may be gone by now
        own = os.getpriority(os.PRIO_PROCESS, 0)
        assert os.getpriority(os.PRIO_PROCESS, child.pid) == min(own + 3, 19)
        assert os.getsid(child.pid) == os.getsid(0)
        assert os.getpgid(child.pid) == child.pid, "Ctrl-C of a terminal is the launcher's alone"
    finally:
        child.stop()


class Loading:
    """A process that has not loaded its nodes yet."""

    def __init__(self, *_: object, **__: object) -> None:
        self.stdin, self.pid, self.is_killed = io.BytesIO(), 1, False

    def kill(self) -> None:
        self.is_killed = True

    def poll(self) -> int | None:
        return -9 if self.is_killed else None

    def wait(self, timeout: float | None = None) -> int:
        if timeout is not None and not self.is_killed:
            raise AssertionError("it is waited for")
        return 0


def test_what_still_loads_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C took five seconds for each process that was loading torch; none of them held anything yet."""
    monkeypatch.setattr(child_module.subprocess, "Popen", Loading)
    order = Order(("twin",), {}, False, False, {}, {}, "test.yaml")
    child = Child("twin", order, tmp_path / "twin.log", lambda: None, lambda line: None)
    child.configure()
    assert b"configure" not in child._process.stdin.getvalue(), "else it might open devices while it is killed"
    child.stop()
    assert child._process.is_killed
    child._on_loaded()
    assert b"configure" not in child._process.stdin.getvalue()


def test_why_a_process_has_ended_is_heard_before_it_is_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy computer the listening thread may come to its turn after the end is known: an error without words."""
    its_turn, ended = threading.Event(), threading.Event()

    def loads(line: str) -> Any:
        assert its_turn.wait(WAIT_S)
        return json.loads(line)

    monkeypatch.setattr(child_module, "json", SimpleNamespace(loads=loads))
    order = Order(("recorder",), {"recorder": {"otput": "run"}}, False, False, {}, {}, "test.yaml")
    child = Child("write", order, tmp_path / "write.log", ended.set, lambda line: None)
    child._process.wait(WAIT_S)
    assert (child.status, child.error) == (REFUSED, None)
    its_turn.set()
    child.hear_out()
    assert child.error is not None
    assert "unknown parameter 'otput'; did you mean 'output'?" in child.error


def test_what_was_cut_by_a_kill_is_no_event(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that listens ended with a trace in place of telling that the process had."""
    heard: list[None] = []

    class Killed(Loading):
        def __init__(self, *_: object, pass_fds: tuple[int, ...], **__: object) -> None:
            super().__init__()
            self.is_killed = True
            os.write(pass_fds[0], b'{"event": "loaded"}\n{"event": "said", "text": "5 of 1')

    monkeypatch.setattr(child_module.subprocess, "Popen", Killed)
    said: list[str] = []
    order = Order(("twin",), {}, False, False, {}, {}, "test.yaml")
    child = Child("twin", order, tmp_path / "twin.log", lambda: heard.append(None), said.append)
    child._listener.join(WAIT_S)
    assert child.is_loaded and said == []
    assert len(heard) == 2, "of its nodes, and of its end"
