"""Charts of a bench: whole or not there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from twin_node.bench.errors import BenchError
from twin_node.bench.results_folder import save_chart


def test_a_chart_is_a_picture_and_a_drawing(tmp_path: Path) -> None:
    assert save_chart(Figure(), tmp_path / "new", "chart") == tmp_path / "new" / "chart.png"
    assert (tmp_path / "new" / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (tmp_path / "new" / "chart.svg").read_text(encoding="utf-8")
    assert len(list((tmp_path / "new").iterdir())) == 2


def test_a_chart_that_cannot_be_written_leaves_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_chart(Figure(), tmp_path, "chart")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(self: Figure, path: Path, **_: Any) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", full)
    with pytest.raises(BenchError, match="No space left"):
        save_chart(Figure(), tmp_path, "chart")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
