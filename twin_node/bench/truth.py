"""Truths that come from outside the images: reference markers, the colour of the moving thing, a simulation's own."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin_node.bag.trc import read_trc
from twin_node.cell import SimulatedRig
from twin_node.cell.shapes import touched_voxels
from twin_node.forecast.score import colour_mask, litres_per_voxel
from twin_node.scene import Bool, Float64, FrameSet, Grid, View


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

        OpenSim's y-up files are `zxy`. Raises `BagError` for a file that is not a `.trc` with positions.
        """
        self._start_ns = start_ns
        table = read_trc(path)
        order = ["xyz".index(axis) for axis in axes]
        self._stamps: NDArray[np.int64] = np.round(table.times * 1e9).astype(np.int64) + start_ns
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


SEEN_PX = 3
"""A thing of which all cameras together show fewer pixels has not been seen: one may be noise."""


class SeenThings:
    """The moving things of a simulated cell that its cameras had seen when the forecast was made."""

    source = "things of the simulated cell that had been seen"

    def __init__(self, simulated: SimulatedRig, grid: Grid, ahead_ns: int) -> None:
        """Forecasts rest on evidence `ahead_ns` older than the time that they are for."""
        self._simulated, self._grid, self._ahead_ns = simulated, grid, ahead_ns
        self._first_seen: dict[int, int] = {}

    def look(self, frames: FrameSet) -> None:
        """Takes note of what a set's cameras see; sets come in rising order of stamps."""
        rows = {camera.name: row for row, camera in enumerate(self._simulated.cameras)}
        owners = [self._simulated.see(rows[view.camera.name], view.stamp).owners for view in frames.views]
        for thing in self._simulated.world.moving_owners:
            if thing not in self._first_seen and sum(int((seen == thing).sum()) for seen in owners) >= SEEN_PX:
                self._first_seen[thing] = frames.stamp

    def occupied(self, stamp: int) -> Float64:
        """[n, 3] centres of all voxels that a moving thing touches at a stamp, m."""
        return self._touched(stamp, self._simulated.world.moving_owners)

    def points(self, stamp: int) -> Float64 | None:
        """The same of the things that had been seen when a forecast for the stamp was made."""
        known = [thing for thing, first in self._first_seen.items() if first <= stamp - self._ahead_ns]
        return self._touched(stamp, known)

    def volume_l(self, stamp: int) -> float | None:
        """Litres of all voxels that a moving thing touches."""
        return len(self.occupied(stamp)) * litres_per_voxel(self._grid)

    def pixels(self, view: View) -> Bool | None:
        """Voxels have no pixels."""
        return None

    def _touched(self, stamp: int, things: Iterable[int]) -> Float64:
        chosen = set(things)
        solids = [solid for solid in self._simulated.world.moving(stamp) if solid.owner in chosen]
        touched = [touched_voxels(solid.placed, self._grid) for solid in solids]
        return self._grid.centers(np.unique(np.concatenate([np.empty(0, np.int64), *touched])))
