"""Truths that come from outside the images: reference markers, the colour of the moving thing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin_node.bag.trc import read_trc
from twin_node.forecast.comparison import Truth
from twin_node.forecast.score import colour_mask
from twin_node.scene import Bool, Float64, View


@dataclass(frozen=True)
class ColourOf:
    """The colour that marks the moving thing."""

    hue: int
    """In OpenCV's half degrees, 0 to 179; orange is 8."""

    def mask(self, rgb: NDArray[np.uint8]) -> Bool:
        """[H, W] True on pixels of the colour."""
        return colour_mask(rgb, self.hue)


class Markers(Truth):
    """Reference markers of a `.trc` file, in `base_link`."""

    source = "markers"

    def __init__(self, path: Path, start_ns: int, axes: str = "zxy") -> None:
        """The file's time 0 is `start_ns`, the log's start; `axes` names the file's axes that are the base frame's x, y
        and z.

        OpenSim's y-up files are `zxy`. Raises `BagError` for a file that is not a `.trc` with positions.
        """
        table = read_trc(path)
        order = ["xyz".index(axis) for axis in axes]
        self._stamps: NDArray[np.int64] = np.round(table.times * 1e9).astype(np.int64) + start_ns
        self._positions = table.positions[..., order]

    def points(self, stamp: int, evidence: int) -> Float64 | None:
        """[n, 3] markers at a stamp, in metres, interpolated; None outside the file's span."""
        after = int(np.searchsorted(self._stamps, stamp))
        if after == 0 or after == len(self._stamps):
            exact = np.flatnonzero(np.abs(self._stamps - stamp) <= 1_000_000)
            return self._positions[exact[0]] if len(exact) else None
        before = after - 1
        share = (stamp - self._stamps[before]) / (self._stamps[after] - self._stamps[before])
        between: Float64 = (1 - share) * self._positions[before] + share * self._positions[after]
        return between


class PixelTruth(Truth):
    """Pixels of one colour: an independent truth in the images where nothing measures space."""

    source = "colour"

    def __init__(self, colour: ColourOf) -> None:
        self._colour = colour

    def pixels(self, view: View) -> Bool | None:
        """[H, W] True on pixels of the colour."""
        return self._colour.mask(view.rgb)
