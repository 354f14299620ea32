"""`twin_node demo`: it says where everything is, and shows it where asked and where it can."""

from __future__ import annotations

import socket
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from twin_node import cell
from twin_node.bench.visitors import free_port
from twin_node.cli import main, replay

WIDTH = 64
"""Of the images, px: what the twin makes of them is not looked at."""


@pytest.fixture
def short_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    """A demo of half a second."""
    load = cell.load_scenario

    def load_short(name: str) -> cell.Scenario:
        scenario = load(name)
        return replace(scenario, duration_s=0.5, sensing=replace(scenario.sensing, width=WIDTH, height=48))

    monkeypatch.setattr(cell, "load_scenario", load_short)
    monkeypatch.setattr(replay, "_run", lambda *given: print(*given[1:]))


def test_it_says_how_to_look_at_it(short_demo: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    assert main(["demo", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert f"twin_node view {tmp_path / 'twin.mcap'} {tmp_path / 'demo.mcap'} --arm ur5e" in said


def test_it_works_without_viser(
    short_demo: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(replay, "find_spec", lambda name: None)
    assert main(["demo", "--out", str(tmp_path), "--viewer"]) == 0
    assert "pip install 'twin-node[viewer]'" in capsys.readouterr().out


def test_it_is_shown_where_asked(short_demo: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    shown: list[Any] = []
    monkeypatch.setattr(replay, "view_log", lambda logs, arm, port: shown.append((logs, arm.model, port)))
    port = free_port()
    assert main(["demo", "--out", str(tmp_path), "--viewer", "--port", str(port)]) == 0
    assert shown == [([tmp_path / "twin.mcap", tmp_path / "demo.mcap"], "ur5e", port)]


def test_a_port_in_use_is_told_before_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["demo", "--out", str(tmp_path / "demo"), "--viewer", "--port", str(port)]) == 2
    assert f"http://127.0.0.1:{port}: cannot be opened" in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()
