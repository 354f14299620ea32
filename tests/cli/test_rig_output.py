"""What becomes of a rig file that a command replaces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin_node.cli.rig_output import write_rig
from twin_node.rig import RigError, RigFile, load_rig, save_rig
from twin_node.scene import Rig, RigCamera


def test_what_a_rig_file_was_is_kept_and_what_is_lost_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
    camera = RigCamera("left", 640, 480, K, np.eye(4), "plumb_bob", np.zeros(5))
    path, plain = tmp_path / "rig.yaml", RigFile(Rig((camera,)))
    write_rig(plain, path)
    assert capsys.readouterr().err == ""
    save_rig(RigFile(Rig((camera,), np.array([[0.0, 0, 0], [1, 1, 1]])), notes="Mind the lamp."), path)
    with path.open("a", encoding="utf-8") as file:
        file.write("# left: do not touch\n")
    before = path.read_bytes()
    write_rig(plain, path)
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert f"{path} is replaced: what it was is in {path}.1; take over" in told
    assert told.strip().endswith("by hand: workspace, notes")
    assert (tmp_path / "rig.yaml.1").read_bytes() == before
    assert load_rig(path).notes == ""
    write_rig(replace(plain, notes="Calibrated anew."), path)
    assert f"is in {path}.2\n" in capsys.readouterr().err
    assert (tmp_path / "rig.yaml.1").read_bytes() == before


def test_what_is_no_rig_file_is_kept_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
    path = tmp_path / "board.yaml"
    path.write_text("kind: charuco\n", encoding="utf-8")
    write_rig(RigFile(Rig((RigCamera("left", 640, 480, K, np.eye(4), "plumb_bob", np.zeros(5)),))), path)
    assert (tmp_path / "board.yaml.1").read_text(encoding="utf-8") == "kind: charuco\n"
    assert "by hand" not in capsys.readouterr().err


@pytest.mark.parametrize("refused", ["rig.yaml.1", "rig.yaml.partial"])
def test_nothing_is_left_beside_a_rig_that_cannot_be_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: str
) -> None:
    """Half of what was to be kept, or all of it once more for each attempt."""
    K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
    path = tmp_path / "rig.yaml"
    path.write_text("mine", encoding="utf-8")
    opened = Path.open

    def full(at: Path, mode: str = "r", *more: Any, **options: Any) -> Any:
        file = opened(at, mode, *more, **options)
        if at.name != refused or mode == "r":
            return file
        file.close()
        return opened(Path("/dev/full"), mode.replace("x", "w"), *more, **options)

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(RigError, match="No space left on device"):
        write_rig(RigFile(Rig((RigCamera("left", 640, 480, K, np.eye(4), "plumb_bob", np.zeros(5)),))), path)
    monkeypatch.undo()
    assert [(one.name, one.read_text(encoding="utf-8")) for one in tmp_path.iterdir()] == [("rig.yaml", "mine")]


def test_what_cannot_be_kept_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
    path = tmp_path / "rig.yaml"
    path.write_text("mine", encoding="utf-8")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(RigError, match="No space left"):
        write_rig(RigFile(Rig((RigCamera("left", 640, 480, K, np.eye(4), "plumb_bob", np.zeros(5)),))), path)
    monkeypatch.undo()
    assert path.read_text(encoding="utf-8") == "mine"
