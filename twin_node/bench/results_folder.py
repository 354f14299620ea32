"""The folder that a bench writes into: charts, figures and tables."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from twin_node.bench.errors import BenchError
from twin_node.json_text import json_text
from twin_node.unfinished import whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def prepared(folder: Path) -> Path:
    """Makes the folder before anything is measured, so that minutes of work are not lost to a wrong name.

    Raises `BenchError` where it cannot be made or written into.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(f"--out {folder}: cannot be made ({error.strerror}); choose another folder") from error
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise BenchError(f"--out {folder}: cannot write into it ({error.strerror}); choose another folder") from error
    return folder


def save_chart(figure: Figure, folder: Path, name: str) -> Path:
    """Writes a chart as NAME.png and NAME.svg; gives the former's path. Raises `BenchError` where it cannot."""
    path = prepared(folder) / f"{name}.png"
    for wanted in (path, path.with_suffix(".svg")):
        with whole_file(wanted, BenchError) as partial:
            figure.savefig(partial, format=wanted.suffix[1:], dpi=100)
    return path


def save_figures(folder: Path, name: str, figures: Mapping[str, object], markdown: str) -> None:
    """Writes figures as NAME.json and a table of them as NAME.md. Raises `BenchError` where it cannot."""
    save_text(folder, f"{name}.json", json_text(figures, 2) + "\n")
    save_text(folder, f"{name}.md", markdown)


def save_text(folder: Path, name: str, text: str) -> None:
    """Writes a file of this name. Raises `BenchError` where it cannot."""
    with whole_file(folder / name, BenchError) as partial:
        partial.write_text(text, encoding="utf-8")
