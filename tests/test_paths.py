"""Whether something is at a path, told alike by all versions of Python."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from twin_node.paths import is_there


def test_files_folders_and_links_are_there_and_what_leads_nowhere_is_not(tmp_path: Path) -> None:
    file, loop, dead = tmp_path / "file", tmp_path / "loop", tmp_path / "dead"
    file.touch()
    loop.symlink_to(loop)
    dead.symlink_to(tmp_path / "none")
    assert is_there(tmp_path) and is_there(file)
    assert not any(map(is_there, (tmp_path / "none", file / "below", loop, dead, tmp_path / "a\0b")))


def test_what_cannot_be_looked_at_is_not_called_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OSError, match="File name too long"):
        is_there(tmp_path / (300 * "n"))

    def refuse(*_: object, **__: object) -> os.stat_result:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "stat", refuse)
    with pytest.raises(PermissionError):
        is_there(tmp_path)
