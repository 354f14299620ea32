"""The folder that a bench writes into: charts, figures and tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from twin_node.bench.errors import BenchError
from twin_node.json_text import json_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def prepared(folder: Path) -> Path:
    """Makes the folder before anything is measured, so that minutes of work are not lost to a wrong name.

    Raises `BenchError` where it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(f"--out {folder}: cannot be made ({error.strerror}); choose another folder") from error
    return folder


def save_chart(figure: Figure, folder: Path, name: str) -> Path:
    """Writes a chart as NAME.png and NAME.svg; gives the former's path. Raises `BenchError` where it cannot."""
    path = prepared(folder) / f"{name}.png"
    try:
        figure.savefig(path, dpi=100)
        figure.savefig(path.with_suffix(".svg"))
    except OSError as error:
        raise BenchError(
            f"--out {folder}: cannot write {path.name} ({error.strerror}); choose another folder"
        ) from error
    return path


def save_figures(folder: Path, name: str, figures: Mapping[str, object], markdown: str) -> None:
    """Writes figures as NAME.json and a table of them as NAME.md. Raises `BenchError` where it cannot."""
    try:
        (folder / f"{name}.json").write_text(json_text(figures, 2) + "\n")
        (folder / f"{name}.md").write_text(markdown)
    except OSError as error:
        raise BenchError(f"--out {folder}: cannot write {name} ({error.strerror}); choose another folder") from error
