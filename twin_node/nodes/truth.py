"""What a log knows to be true of its moving things, or, for want of that, what the twin saw when the time had come."""

from __future__ import annotations

import numpy as np

from twin_node.bag import LogReader
from twin_node.forecast.comparison import Truth
from twin_node.forecast.score import litres_per_voxel
from twin_node.messages import convert
from twin_node.nodes.topics import TRUTH_OCCUPANCY
from twin_node.scene import Bool, Float64, View

STALE_NS = 26_000_000
"""Truth further than this from the time asked for is none: half a period at 20 Hz."""
OBSERVED_NS = 51_000_000
"""What the twin itself saw is taken for times this far from it: half a period where it keeps up at 10 Hz only."""


class _Sampled(Truth):
    """What moves, known at some times."""

    reach_ns: int
    """It is taken for times this far from them."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._points: list[Float64] = []
        self._volumes: list[float] = []

    def observe(self, stamp: int, points: Float64, volume_l: float) -> None:
        """Remembers what moves at a stamp, ns: points [n, 3] in m."""
        self._stamps.append(stamp)
        self._points.append(points)
        self._volumes.append(volume_l)

    def points(self, stamp: int, evidence: int) -> Float64 | None:
        """[n, 3] centres of the moving voxels nearest in time, m, whatever had been seen of them."""
        row = self._row(stamp)
        return None if row is None else self._points[row]

    def volume_l(self, stamp: int) -> float | None:
        """Litres of the moving voxels nearest in time."""
        row = self._row(stamp)
        return None if row is None else self._volumes[row]

    def _row(self, stamp: int) -> int | None:
        if not self._stamps:
            return None
        row = int(np.abs(np.array(self._stamps, np.int64) - stamp).argmin())
        return row if abs(self._stamps[row] - stamp) <= self.reach_ns else None


class VoxelTruth(_Sampled):
    """Exact moving voxels that a log carries."""

    source = TRUTH_OCCUPANCY
    reach_ns = STALE_NS

    def __init__(self, log: LogReader) -> None:
        super().__init__()
        for message in log.messages([TRUTH_OCCUPANCY]):
            occupancy = convert.occupancy_from_message(message.message)
            points = occupancy.grid.centers(occupancy.layers[0].indices)
            self.observe(occupancy.stamp, points, len(points) * litres_per_voxel(occupancy.grid))

    def occupied(self, stamp: int) -> Float64 | None:
        """The same: all that moves."""
        return self.points(stamp, stamp)


class LaterTruth(_Sampled):
    """What the twin itself saw to move when the time had come: no independent truth, for want of a better one."""

    source = "hull observed when the time had come"
    reach_ns = OBSERVED_NS

    def __init__(self) -> None:
        super().__init__()
        self._masks: dict[tuple[str, int], Bool] = {}

    def observe(self, stamp: int, points: Float64, volume_l: float) -> None:
        """Remembers what was seen to move at a stamp; 64 observations are kept."""
        super().observe(stamp, points, volume_l)
        del self._stamps[:-64], self._points[:-64], self._volumes[:-64]

    def observe_mask(self, view: View, mask: Bool) -> None:
        """Remembers the moving mask of a view; those of the last 64 views are kept."""
        self._masks[view.camera.name, view.stamp] = mask
        while len(self._masks) > 64:
            del self._masks[next(iter(self._masks))]

    def pixels(self, view: View) -> Bool | None:
        """[H, W] the moving mask of the view."""
        return self._masks.get((view.camera.name, view.stamp))
