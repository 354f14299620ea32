"""What helps say agrees with the documents."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin_node.cli import main

ROOT = Path(__file__).parents[2]


def test_the_drivers_help_has_the_lines_that_a_robots_program_needs(capsys: pytest.CaptureFixture[str]) -> None:
    """The watchdog alone pauses a program before the twin has come."""
    before, _, after = (
        (ROOT / "README.md").read_text(encoding="utf-8").partition('"input_int_register_20", 10, "pause")')
    )
    lines = [
        *before.rpartition("```\n")[2].splitlines()[:-1],
        'rtde_set_watchdog("input_int_register_20", 10, "pause")',
    ]
    assert len(lines) == 4
    assert after.startswith("\n```")
    with pytest.raises(SystemExit):
        main(["ur-driver", "--help"])
    said = [line.strip() for line in capsys.readouterr().out.splitlines()]
    begun = said.index(lines[0])
    assert said[begun : begun + 4] == [line.strip() for line in lines]
