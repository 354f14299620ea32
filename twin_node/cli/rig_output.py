"""Rig files that commands write: what stood there before is kept, and what the new ones lack is told."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from twin_node.cli.output import warn

if TYPE_CHECKING:
    from twin_node.rig import RigFile


def today() -> str:
    """The date that a rig file written now has."""
    return datetime.now(UTC).date().isoformat()


def write_rig(rig_file: RigFile, path: Path) -> None:
    """Writes a rig file. One that it replaces, with the comments in it, goes on beside it as NAME.1, NAME.2, ...

    Raises `RigError` where either cannot be written.
    """
    from twin_node.rig import RigError, save_rig

    lost, kept = _lost(path, rig_file), _kept(path)
    try:
        save_rig(rig_file, path)
    except RigError:
        if kept is not None:
            kept.unlink(missing_ok=True)
        raise
    if kept is None:
        return
    by_hand = f"; take over from there what was written by hand: {', '.join(lost)}" if lost else ""
    warn(f"{path} is replaced: what it was is in {kept}{by_hand}")


def _kept(path: Path) -> Path | None:
    """Where a file that is about to be replaced goes on; None where there is none."""
    from twin_node.rig import RigError

    if not path.is_file():
        return None
    try:
        content = path.read_bytes()
        for number in count(1):
            kept = path.with_name(f"{path.name}.{number}")
            try:
                file = kept.open("xb")
            except FileExistsError:
                continue
            try:
                with file:
                    file.write(content)
            except OSError:
                kept.unlink(missing_ok=True)
                raise
            return kept
    except OSError as error:
        raise RigError(
            f"{path}: expected to keep it beside the new one, found that it cannot be ({error.strerror}); "
            "choose another name"
        ) from None
    return None


def _lost(path: Path, rig_file: RigFile) -> list[str]:
    """What a rig file that is about to be replaced holds that no calibration writes, and the new one does not hold."""
    from twin_node.rig import RigError, load_rig

    if not path.is_file():
        return []
    try:
        before = load_rig(path, facing=False)
    except RigError:  # no rig file: nothing of it could be taken over
        return []
    held = {
        "workspace": before.rig.workspace is not None and rig_file.rig.workspace is None,
        "notes": before.notes not in rig_file.notes,
        "videos": any(before.sources) and not any(rig_file.sources),
    }
    return [name for name, gone in held.items() if gone]
