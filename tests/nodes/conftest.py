"""A small log of a twin, and commands that are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from twin_logs import write_twin_log

from twin_node.cli import main


@pytest.fixture(scope="session")
def twin_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Path of a log of what a twin publishes, with known values; see `twin_logs`."""
    path = tmp_path_factory.mktemp("twin") / "twin.mcap"
    write_twin_log(path)
    return path


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """`refused(*arguments)`: what a command says that ends with status 2 and leaves the folder it runs in as it was."""

    def run(*arguments: object) -> str:
        monkeypatch.chdir(tmp_path)
        before = sorted(tmp_path.iterdir())
        assert main([str(argument) for argument in arguments]) == 2
        assert sorted(tmp_path.iterdir()) == before
        return capsys.readouterr().err

    return run
