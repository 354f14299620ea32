"""The folder that a bench writes into."""

from __future__ import annotations

from pathlib import Path

from twin_node.bench.errors import BenchError


def prepared(folder: Path) -> Path:
    """Makes the folder before anything is measured, so that minutes of work are not lost to a wrong name.

    Raises `BenchError` where it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(f"--out {folder}: cannot be made ({error.strerror}); choose another folder") from error
    return folder
