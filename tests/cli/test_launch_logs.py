"""Where the logs of a launch's processes go."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from twin_node.cli import main
from twin_node.nodes.launch import launcher

ROOT = Path(__file__).parents[2]


@pytest.fixture
def folders(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Path]:
    """Those of launches that are begun in the same second, and run nothing."""
    found: list[Path] = []

    def made(_: object, folder: Path, *__: object) -> Any:
        found.append(folder)
        return SimpleNamespace(run=lambda: SimpleNamespace(failed=None, status=0), interrupt=lambda: None)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("twin_node.cli.launch.time.strftime", lambda _: "20260101-120000")
    monkeypatch.setattr("twin_node.cli.launch.signal.signal", lambda *_: None)
    monkeypatch.setattr(launcher, "Launcher", made)
    return found


def test_launches_of_one_second_have_logs_of_their_own(folders: list[Path]) -> None:
    for _ in range(3):
        assert main(["launch", str(ROOT / "launch" / "sim_cell.yaml")]) == 0
    assert [folder.name for folder in folders] == [
        "20260101-120000-sim_cell",
        "20260101-120000-sim_cell-2",
        "20260101-120000-sim_cell-3",
    ]


def test_where_no_folder_can_be_made_the_launcher_is_left_to_say_so(folders: list[Path]) -> None:
    Path("out").write_text("no folder")
    assert main(["launch", str(ROOT / "launch" / "sim_cell.yaml")]) == 0
    assert [str(folder) for folder in folders] == ["out/log/20260101-120000-sim_cell"]
