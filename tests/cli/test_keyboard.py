"""Enter at a terminal: heard where it is for the command, and nowhere else."""

from __future__ import annotations

import os
import pty
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from twin_node.cli import keyboard


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """What is written here is typed at a terminal that nobody was started from."""
    master, slave = pty.openpty()
    with os.fdopen(slave, encoding="utf-8") as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        yield master
    os.close(master)


def in_background(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.tcgetpgrp", lambda _: os.getpgrp() + 1)


def test_enter_is_told_once(keys: int) -> None:
    assert not keyboard.enter_pressed()
    os.write(keys, b"\n")
    assert keyboard.enter_pressed()
    assert not keyboard.enter_pressed()


def test_keys_are_left_to_who_is_in_the_foreground(keys: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Enter for something else stopped a driver that had been started with `&`: the system lets none read it there."""
    os.write(keys, b"\n")
    with monkeypatch.context() as patch:
        in_background(patch)
        assert not keyboard.enter_pressed()
    assert keyboard.enter_pressed()


def test_lines_wait_for_the_foreground_and_end_with_the_terminal(keys: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """`play LOG &` was stopped at once."""
    with monkeypatch.context() as patch:
        in_background(patch)
        patch.setattr("time.sleep", lambda _: patch.undo())  # brought to the foreground meanwhile
        os.write(keys, b"one\ntwo\n")
        found = keyboard.lines()
        assert [next(found), next(found)] == ["one\n", "two\n"]
    end = termios.tcgetattr(keys)[6][termios.VEOF]
    os.write(keys, end if isinstance(end, bytes) else bytes([end]))
    assert list(found) == []


def test_nobody_types_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    with Path(os.devnull).open(encoding="utf-8") as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        assert not keyboard.enter_pressed()
