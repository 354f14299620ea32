"""Finds the data folders (`msgs`, `launch`, `sim`, `calibration`) in a checkout and in an installed package alike."""

from __future__ import annotations

import difflib
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
    raise ResourceError(f"{name}: no such file (looked in {Path.cwd()}, {places}); {_advice(path)}")


def _advice(path: Path) -> str:
    """What to name instead: what has that name in a data folder, or nearly so in its own; or all that there is."""
    own = _names(path.parent.name, path.suffix) if path.parent.name in FOLDERS else []
    like = difflib.get_close_matches(path.stem, own, n=1)
    meant = [f"{folder}/{path.name}" for folder in FOLDERS if path.stem in _names(folder, path.suffix)]
    meant = meant or [f"{path.parent.name}/{name}{path.suffix}" for name in like]
    if meant:
        return f"did you mean {' or '.join(meant)}?"
    return f"{path.parent.name} has {', '.join(own)}" if own else "check the spelling of the path"


def _names(folder: str, suffix: str) -> list[str]:
    """Names, without that suffix, of the files of a data folder, in every root."""
    places = [root / folder for root in roots() if (root / folder).is_dir()]
    return sorted(
        {file.stem for place in places for file in place.iterdir() if file.is_file() and file.suffix == suffix}
    )


def _is_there(path: Path) -> bool:
    """Whether something is there, or nobody may look: who opens it is told why not."""
    try:
        return is_there(path)
    except OSError:
        return True
