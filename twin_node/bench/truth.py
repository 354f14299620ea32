"""Where the truth about a recording comes from: markers, exact voxels, a colour, or the twin itself later."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin_node.bag import LogReader
from twin_node.bench.errors import BenchError
from twin_node.forecast.score import colour_mask, litres_per_voxel
from twin_node.messages import convert
from twin_node.scene import Bool, Float64, View

TRUTH_TOPIC = "/truth/occupancy"
"""Exact moving voxels, as the simulated cell records them."""
STALE_NS = 26_000_000
"""Truth further than this from the time asked for is none: half a period at 20 Hz."""


@dataclass(frozen=True)
class ColourOf:
    """The colour that marks the moving thing."""

    hue: int
    """In OpenCV's half degrees, 0 to 179; orange is 8."""
    tolerance: int = 10
    """Half degrees either side."""

    def mask(self, rgb: NDArray[np.uint8]) -> Bool:
        """[H, W] True on pixels of the colour."""
        return colour_mask(rgb, self.hue, self.tolerance)


class Markers:
    """Reference markers of a `.trc` file, in `base_link`."""

    source = "markers"

    def __init__(self, path: Path, start_ns: int, axes: str = "zxy") -> None:
        """The file's time 0 is `start_ns`; `axes` names the file's axes that are the base frame's x, y and z.

        OpenSim's y-up files are `zxy`. Raises `BenchError` for a file that is not a `.trc` with positions.
        """
        self._start_ns = start_ns
        table = _read_trc(path)
        order = ["xyz".index(axis) for axis in axes]
        self._stamps: NDArray[np.int64] = np.round(table.seconds * 1e9).astype(np.int64) + start_ns
        self._positions = table.positions[..., order]

    def points(self, stamp: int) -> Float64 | None:
        """[n, 3] markers at a stamp, in metres, interpolated; None outside the file's span."""
        after = int(np.searchsorted(self._stamps, stamp))
        if after == 0 or after == len(self._stamps):
            exact = np.flatnonzero(np.abs(self._stamps - stamp) <= 1_000_000)
            return self._positions[exact[0]] if len(exact) else None
        before = after - 1
        share = (stamp - self._stamps[before]) / (self._stamps[after] - self._stamps[before])
        between: Float64 = (1 - share) * self._positions[before] + share * self._positions[after]
        return between

    def volume_l(self, stamp: int) -> float | None:
        """Markers have no volume."""
        return None

    def pixels(self, view: View) -> Bool | None:
        """Markers have no pixels."""
        return None


class VoxelTruth:
    """Exact moving voxels that a log carries."""

    source = TRUTH_TOPIC

    def __init__(self, log: LogReader) -> None:
        self._points: list[Float64] = []
        self._volumes: list[float] = []
        stamps = []
        for message in log.messages([TRUTH_TOPIC]):
            occupancy = convert.occupancy_from_message(message.message)
            stamps.append(occupancy.stamp)
            self._points.append(occupancy.grid.centers(occupancy.layers[0].indices))
            self._volumes.append(len(self._points[-1]) * litres_per_voxel(occupancy.grid))
        self._stamps = np.array(stamps, dtype=np.int64)

    def points(self, stamp: int) -> Float64 | None:
        """[n, 3] centres of the moving voxels nearest in time, m."""
        row = self._row(stamp)
        return None if row is None else self._points[row]

    def volume_l(self, stamp: int) -> float | None:
        """Litres of the moving voxels nearest in time."""
        row = self._row(stamp)
        return None if row is None else self._volumes[row]

    def pixels(self, view: View) -> Bool | None:
        """Voxels have no pixels."""
        return None

    def _row(self, stamp: int) -> int | None:
        if len(self._stamps) == 0:
            return None
        row = int(np.abs(self._stamps - stamp).argmin())
        return row if abs(int(self._stamps[row]) - stamp) <= STALE_NS else None


class PixelTruth:
    """Pixels of one colour: an independent truth in the images where nothing measures space."""

    source = "colour"

    def __init__(self, colour: ColourOf) -> None:
        self._colour = colour

    def points(self, stamp: int) -> Float64 | None:
        """Pixels have no depth."""
        return None

    def volume_l(self, stamp: int) -> float | None:
        """Pixels have no volume."""
        return None

    def pixels(self, view: View) -> Bool | None:
        """[H, W] True on pixels of the colour."""
        return self._colour.mask(view.rgb)


class LaterTruth:
    """What the twin itself saw to move when the time had come: no independent truth, for want of a better one."""

    source = "hull observed when the time had come"

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._points: list[Float64] = []
        self._volumes: list[float] = []
        self._masks: dict[tuple[str, int], Bool] = {}

    def observe(self, stamp: int, points: Float64, volume_l: float) -> None:
        """Remembers what was seen to move at a stamp; 64 observations are kept."""
        self._stamps.append(stamp)
        self._points.append(points)
        self._volumes.append(volume_l)
        del self._stamps[:-64], self._points[:-64], self._volumes[:-64]

    def observe_mask(self, view: View, mask: Bool) -> None:
        """Remembers the moving mask of a view; those of the last 64 views are kept."""
        self._masks[view.camera.name, view.stamp] = mask
        while len(self._masks) > 64:
            del self._masks[next(iter(self._masks))]

    def points(self, stamp: int) -> Float64 | None:
        """[n, 3] centres of the voxels seen to move nearest in time, m."""
        row = self._row(stamp)
        return None if row is None else self._points[row]

    def volume_l(self, stamp: int) -> float | None:
        """Litres of the voxels seen to move nearest in time."""
        row = self._row(stamp)
        return None if row is None else self._volumes[row]

    def pixels(self, view: View) -> Bool | None:
        """[H, W] the moving mask of the view."""
        return self._masks.get((view.camera.name, view.stamp))

    def _row(self, stamp: int) -> int | None:
        if not self._stamps:
            return None
        row = int(np.abs(np.array(self._stamps) - stamp).argmin())
        return row if abs(self._stamps[row] - stamp) <= STALE_NS else None


@dataclass(frozen=True)
class _Table:
    seconds: Float64
    """[T] s."""
    positions: Float64
    """[T, n, 3] m, in the file's axes; NaN where a marker is missing."""


def _read_trc(path: Path) -> _Table:
    """Reads OpenSim's `.trc` (Track Row Column) text: five header lines, then frame, time and x y z per marker."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BenchError(f"{path}: expected a readable .trc file, found {error}; check the path") from None
    if len(lines) < 5 or not lines[0].startswith("PathFileType"):
        raise BenchError(f"{path}: expected a .trc file (first line 'PathFileType ...'); give a file of that kind")
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    scale = {"m": 1.0, "mm": 1e-3}.get(header.get("Units", "").strip())
    if scale is None:
        raise BenchError(f"{path}: Units: expected m or mm, found {header.get('Units')!r}; correct the header")
    count = int(header.get("NumMarkers", "0"))
    rows = []
    for number, line in enumerate(lines[5:], start=6):
        if not line.strip():
            continue
        values = [float(text) if text.strip() else np.nan for text in line.rstrip("\r").split("\t")[: 2 + 3 * count]]
        if len(values) != 2 + 3 * count:
            raise BenchError(f"{path}: line {number}: expected {2 + 3 * count} columns, found {len(values)}")
        rows.append(values)
    if not rows:
        raise BenchError(f"{path}: expected rows of marker positions, found none")
    table = np.array(rows)
    return _Table(table[:, 1] - table[0, 1], table[:, 2:].reshape(len(table), count, 3) * scale)
