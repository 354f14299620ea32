"""What is written as NAME.partial and gets its name when it is whole; a NAME.partial of somebody else is left alone."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from twin_node.errors import TwinError, reason


def partial_of(path: Path) -> Path:
    """Where a file or folder is until it is whole."""
    return path.with_name(f"{path.name}.partial")


def is_taken(path: Path) -> bool:
    """Whether a NAME.partial is there: another writer's, or all that is left of one that was killed."""
    return os.path.lexists(partial_of(path))


def taken(path: Path) -> str:
    """The error of who finds a NAME.partial there."""
    return (
        f"{partial_of(path)}: exists already, left by what was never finished or is being written; move it "
        "elsewhere, remove it or choose another name"
    )


def unwritable(path: Path, problem: Exception) -> str:
    """The error of who cannot write a file or folder, and why."""
    return f"{path}: cannot be written ({reason(problem)}); free space or choose another place"


def refuse_taken(path: Path, error: type[TwinError]) -> None:
    """Raises `error` where `path` could not be written for a NAME.partial, before the work that it is to keep."""
    if is_taken(path):
        raise error(taken(path))


@contextlib.contextmanager
def whole_file(path: Path, error: type[TwinError]) -> Iterator[Path]:
    """The path to write to; the file gets its name at the end, or nothing is left of it.

    Raises `error` where NAME.partial is there already, and for any `OSError` meanwhile: it cannot be written.
    """
    partial = partial_of(path)
    try:
        partial.open("xb").close()
    except FileExistsError:
        raise error(taken(path)) from None
    except OSError as problem:
        raise error(unwritable(path, problem)) from None
    try:
        yield partial
        partial.replace(path)
    except OSError as problem:
        raise error(unwritable(path, problem)) from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
