"""The example in `docs/arm.md` runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from obstacle_sets import NOW, Thing, obstacles

from twin_node.bag import LogWriter
from twin_node.messages import convert

PAGE = Path(__file__).resolve().parents[2] / "docs" / "arm.md"


def test_the_example_reads_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    example = re.search(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    assert example is not None
    with LogWriter(tmp_path / "twin.mcap") as log:
        far = convert.obstacles_to_message(obstacles(Thing((3.0, 0.0, 0.5))))
        near = convert.obstacles_to_message(obstacles(Thing((0.5, 0.0, 0.2), size=(0.6,) * 3)))
        log.write("/twin/obstacles", far, NOW)
        log.write("/twin/obstacles", near, NOW + 33_000_000)
    monkeypatch.chdir(tmp_path)
    exec(compile(example.group(1), str(PAGE), "exec"), {})
    first, second = capsys.readouterr().out.splitlines()
    assert first.endswith("m, 100%: clear")
    assert float(second.split()[0]) <= 0
