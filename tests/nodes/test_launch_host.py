"""A process of a launch whose launcher has died."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest

from twin_node.nodes.launch import host


def test_a_process_whose_node_hangs_ends_after_its_launcher(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody else would end it: the next launch found its arm's driver still there."""
    done: list[object] = []
    monkeypatch.setattr(host.sys, "stdin", io.StringIO("activate\n"))
    monkeypatch.setattr(host, "time", SimpleNamespace(sleep=done.append))
    monkeypatch.setattr(host, "os", SimpleNamespace(_exit=done.append))
    graph = SimpleNamespace(activate=lambda: done.append("active"), stop=lambda: done.append("told to stop"))
    host._obey(graph)
    assert done == ["active", "told to stop", host.LAST_S, host.FAILED]
