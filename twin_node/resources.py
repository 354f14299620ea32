"""Finds the data folders (`msgs`, `launch`, `sim`, `calibration`) in a checkout and in an installed package alike."""

from __future__ import annotations

import sys
import sysconfig
from pathlib import Path

from twin_node.errors import TwinError
from twin_node.paths import is_there

FOLDERS = ("launch", "sim", "calibration")
"""Data folders with files that users name."""


class ResourceError(TwinError):
    """A file that ships with the package, or that the user named, is not there."""


def roots() -> list[Path]:
    """Folders that may hold the data folders, in order of preference: the checkout, then the installation's `share`."""
    checkout = Path(__file__).resolve().parent.parent
    shares = [Path(sysconfig.get_path("data")), Path(sys.prefix)]
    return [checkout, *(share / "share" / "twin_node" for share in dict.fromkeys(shares))]


def find(name: str | Path) -> Path:
    """Path of `name`: as given if it exists, else below one of the data roots (`launch/replay.yaml`).

    Raises `ResourceError` naming where it was looked for.
    """
    path = Path(name)
    if _is_there(path):
        return path
    candidates = [] if path.is_absolute() else [root / path for root in roots()]
    for candidate in candidates:
        if _is_there(candidate):
            return candidate
    places = ", ".join(str(candidate.parent) for candidate in candidates) or str(path.parent)
    meant = _namesakes(path)
    advice = f"did you mean {' or '.join(meant)}?" if meant else "check the spelling of the path"
    raise ResourceError(f"{name}: no such file (looked in {Path.cwd()}, {places}); {advice}")


def _namesakes(path: Path) -> list[str]:
    """What of that name lies in a data folder, as `find` takes it."""
    found = (folder / path.name for root in roots() if root.is_dir() for folder in map(root.joinpath, FOLDERS))
    return list(dict.fromkeys(f"{one.parent.name}/{one.name}" for one in found if path.name and one.is_file()))


def _is_there(path: Path) -> bool:
    """Whether something is there, or nobody may look: who opens it is told why not."""
    try:
        return is_there(path)
    except OSError:
        return True
