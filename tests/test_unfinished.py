"""Files are written as NAME.partial: one of somebody else stays, and nothing half-written bears a name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from twin_node.errors import TwinError
from twin_node.model.ply import StoredGaussians, write_ply
from twin_node.model.sequence.tensor_file import write_tensors
from twin_node.nodes.film import write_film, write_picture
from twin_node.nodes.report.page import _write
from twin_node.rig.calibrate.board_prints import print_board
from twin_node.rig.calibrate.boards import Chessboard
from twin_node.unfinished import whole_file
from twin_node.yaml_file import write_yaml

GAUSSIAN = StoredGaussians(*(np.zeros(shape, np.float32) for shape in ((1, 3), (1, 4), (1, 3), (1,), (1, 1, 3))))
PICTURE = np.zeros((16, 16, 3), np.uint8)
WRITERS: dict[str, Callable[[Path], object]] = {
    "cloud.ply": lambda path: write_ply(GAUSSIAN, path),
    "model.safetensors": lambda path: write_tensors({"a": torch.zeros(1)}, {}, path),
    "film.mp4": lambda path: write_film(iter([PICTURE]), 30, path),
    "picture.png": lambda path: write_picture(PICTURE, path),
    "report.html": lambda path: _write(path.parent, {"report.json": "{}", "report.html": "page"}),
    "rig.yaml": lambda path: write_yaml(path, {"a": 1}, TwinError),
    "board.svg": lambda path: print_board(Chessboard(9, 6, 0.025), path),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_partial_file_of_somebody_else_stays(tmp_path: Path, name: str) -> None:
    if name == "film.mp4":
        pytest.importorskip("av")
    mine = tmp_path / f"{name}.partial"
    mine.write_text("precious")
    with pytest.raises(TwinError, match=rf"{name}\.partial: exists already, .*; move it elsewhere"):
        WRITERS[name](tmp_path / name)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(mine.name, "precious")]
    mine.unlink()
    WRITERS[name](tmp_path / name)
    assert (tmp_path / name).stat().st_size > 0
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_written_may_be_read_by_who_may_read_other_files(tmp_path: Path, name: str) -> None:
    if name == "film.mp4":
        pytest.importorskip("av")
    WRITERS[name](tmp_path / name)
    other = tmp_path / "other"
    other.touch()
    assert (tmp_path / name).stat().st_mode == other.stat().st_mode


def test_what_breaks_off_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), whole_file(path, TwinError) as partial:
        partial.write_text("half")
        raise KeyboardInterrupt
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.txt", "old")]
