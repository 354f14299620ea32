"""Where no folder takes temporary files, as in a container whose disk is read-only: what needs none goes on."""

from __future__ import annotations

import errno
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from twin_node.cli import main


def test_what_needs_one_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, refused: Callable[..., str]
) -> None:
    """As Matplotlib and torch, which end with a traceback while they load."""

    def refuse() -> str:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    def load(_options: object) -> None:
        raise OSError("Matplotlib requires access to a writable cache directory")

    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_get_default_tempdir", refuse)
    monkeypatch.setattr("twin_node.cli.logs._info", load)
    assert "free space, or set TMPDIR to one that does" in refused("info", tmp_path / "log.mcap")


def test_another_failure_of_a_disk_is_not_taken_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_options: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("twin_node.cli.logs._info", fail)
    with pytest.raises(OSError, match="Input/output error"):
        main(["info", "log.mcap"])


def test_a_replay_without_a_report_draws_nothing(
    cell_log: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Matplotlib wants a folder of its own in the user's home, and complains on the terminal where there is none."""
    for name in [name for name in sys.modules if name.startswith("twin_node.nodes.report")]:
        monkeypatch.delitem(sys.modules, name)
    log, twin = str(cell_log(0.5)), str(tmp_path / "twin.mcap")
    assert main(["replay", log, "--lockstep", "--duration", "0.2", "--width", "80", "-o", twin]) == 0
    assert "twin_node.nodes.report.pictures" not in sys.modules
