"""Recorded 3D trajectories of named points, and what their files have in common."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.bag.log import BagError
from twin_node.errors import reason, several
from twin_node.scene import Float64

_WIDEST_M = 100.0
"""What is followed point by point lies within so much along each axis, m: numbers that span more are no metres."""


@dataclass(frozen=True)
class Trajectories:
    """Where named points were over time."""

    names: tuple[str, ...]
    """[J]."""
    times: Float64
    """[T] s, strictly increasing."""
    positions: Float64
    """[T, J, 3] m, in the file's own axes; NaN where a point was not seen."""

    @property
    def rate_hz(self) -> float:
        """Samples per second, from the median step."""
        return float(1 / np.median(np.diff(self.times)))


def read_lines(path: Path) -> list[str]:
    """Lines of a text file. Raises `BagError` where it cannot be read as text."""
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"{path}: expected a readable text file, found: {reason(error)}; check the path") from None


def checked(path: Path, names: tuple[str, ...], times: Float64, positions: Float64) -> Trajectories:
    """The record of what a file holds.

    Raises `BagError` for too few samples, names that stand twice, times that do not rise, and positions that are
    infinite or span more than metres can.
    """
    if len(times) < 2 or not names:
        found = f"{several(len(names), 'point')} at {several(len(times), 'time')}"
        raise BagError(f"{path}: expected points at two or more times, found {found}")
    again = [name for row, name in enumerate(names) if name in names[:row]]
    if again:
        raise BagError(f"{path}: expected every point's name once, found {again[0]!r} again; rename one of them")
    rises = np.append(True, np.diff(times) > 0) & np.isfinite(times)
    if not rises.all():
        row = max(int(rises.argmin()), 1)
        raise BagError(f"{path}: sample {row + 1}: expected rising times, found {times[row]} after {times[row - 1]} s")
    if np.isinf(positions).any():
        row, point, _ = np.argwhere(np.isinf(positions))[0]
        raise BagError(
            f"{path}: sample {row + 1}: expected finite numbers, found infinity for {names[point]}; leave cells of "
            "points that were not seen empty"
        )
    seen = positions[~np.isnan(positions).any(axis=2)]
    with np.errstate(over="ignore"):
        span = float(np.ptp(seen, axis=0).max()) if len(seen) else 0.0
    if span > _WIDEST_M:
        raise BagError(
            f"{path}: expected points within {_WIDEST_M:g} m of each other, found {span:.6g} m; are the positions in "
            "another unit?"
        )
    return Trajectories(names, times, positions)


def number(path: Path, line: int, text: str) -> float:
    """A cell's number, NaN for an empty one. Raises `BagError` for anything else."""
    try:
        return float(text) if text.strip() else float("nan")
    except ValueError:
        raise BagError(f"{path}: line {line}: expected a number, found '{text.strip()[:30]}'") from None
