"""A small log of a twin, and commands that are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from twin_logs import write_twin_log


@pytest.fixture(scope="session")
def twin_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Path of a log of what a twin publishes, with known values; see `twin_logs`."""
    path = tmp_path_factory.mktemp("twin") / "twin.mcap"
    write_twin_log(path)
    return path


@pytest.fixture
def refused(refused: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """As everywhere; the command runs in `tmp_path`."""
    monkeypatch.chdir(tmp_path)
    return refused
