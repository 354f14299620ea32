"""Ctrl-C while a command still loads: one line and status 130, as later."""

from __future__ import annotations

import subprocess
import sys
from typing import NoReturn

import pytest

from twin_node.cli import main


def test_an_interrupt_that_a_compiled_module_met_is_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As pybind11's modules tell it."""

    def load(*_: object) -> NoReturn:
        raise ImportError("initialization failed") from ImportError("initialization failed")

    def load_interrupted(*_: object) -> NoReturn:
        inner = ImportError("initialization failed")
        inner.__cause__ = KeyboardInterrupt()
        raise ImportError("initialization failed") from inner

    monkeypatch.setattr("twin_node.bag.open_log", load_interrupted)
    assert main(["info", "run.mcap"]) == 130
    assert capsys.readouterr().err == "twin_node: interrupted\n"
    monkeypatch.setattr("twin_node.bag.open_log", load)
    with pytest.raises(ImportError, match="initialization failed"):
        main(["info", "run.mcap"])


def test_commands_load_where_an_interrupt_is_met() -> None:
    """They take a second on a busy machine, and the program's own script cannot catch what comes meanwhile."""
    script = (
        "import sys, twin_node.cli; print([m for m in sys.modules if m == 'tqdm' or m.startswith('twin_node.cli.') "
        "and m not in ('twin_node.cli.ending', 'twin_node.cli.parser')])"
    )
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "[]\n"
