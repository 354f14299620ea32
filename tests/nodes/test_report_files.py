"""What a report leaves on the disk."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from twin_node.nodes.report.figures import _plain
from twin_node.nodes.report.page import ReportError, _write


def test_figures_that_are_not_finite_are_null_however_deep() -> None:
    """JSON knows no NaN: a strict reader would refuse the whole file."""
    figures = {"cameras": {"left": {"changes": [{"turn_deg": float("nan"), "at_s": 1.0}]}}}
    assert json.loads(json.dumps(_plain(figures), allow_nan=False))["cameras"]["left"]["changes"] == [
        {"turn_deg": None, "at_s": 1.0}
    ]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_a_report_that_breaks_off_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    (tmp_path / "report.json").write_text("old")
    write = Path.write_text

    def refuse(path: Path, text: str, encoding: str) -> int:
        written = write(path, text[:1], encoding=encoding)
        if path.name.startswith("report.html"):
            raise error
        return written

    monkeypatch.setattr(Path, "write_text", refuse)
    with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else ReportError):
        _write(tmp_path, {"report.json": "new", "report.html": "new"})
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("report.json", "old")]
