"""What a log knows to be true of its moving things, or, for want of that, what the twin saw when the time had come."""

from __future__ import annotations

import numpy as np

from twin_node.bag import LogReader
from twin_node.forecast.comparison import Truth
from twin_node.forecast.score import litres_per_voxel
from twin_node.messages import convert
from twin_node.nodes.topics import TRUTH_OCCUPANCY
from twin_node.scene import Bool, Float64, Grid, Occupancy, TwinState, UInt32, View

STALE_NS = 26_000_000
"""Truth further than this from the time asked for is none: half a period at 20 Hz."""
OBSERVED_NS = 51_000_000
"""What the twin itself saw is taken for times this far from it: half a period where it keeps up at 10 Hz only."""


def has_exact_truth(log: LogReader) -> bool:
    """Whether a log carries its exact moving voxels."""
    return any(topic.name == TRUTH_OCCUPANCY for topic in log.topics)


def truth_of(log: LogReader) -> Truth:
    """The best truth that a log by itself leads to."""
    return VoxelTruth(log) if has_exact_truth(log) else LaterTruth()


class _Sampled(Truth):
    """What moves, known at some times."""

    reach_ns: int
    """It is taken for times this far from them."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._points: list[Float64] = []
        self._volumes: list[float] = []

    def remember(self, stamp: int, points: Float64, volume_l: float) -> None:
        """Takes in what moves at a stamp, ns: points [n, 3] in m."""
        self._stamps.append(stamp)
        self._points.append(points)
        self._volumes.append(volume_l)

    def remember_layer(self, stamp: int, occupancy: Occupancy) -> None:
        """Takes in that the first layer moves at a stamp, ns."""
        points = occupancy.grid.centers(occupancy.layers[0].indices)
        self.remember(stamp, points, len(points) * litres_per_voxel(occupancy.grid))

    def points(self, stamp: int, evidence: int) -> Float64 | None:
        """[n, 3] centres of the moving voxels nearest in time, m, whatever had been seen of them."""
        row = self._row(stamp)
        return None if row is None else self._points_of(row)

    def volume_l(self, stamp: int) -> float | None:
        """Litres of the moving voxels nearest in time."""
        row = self._row(stamp)
        return None if row is None else self._volumes[row]

    def _points_of(self, row: int) -> Float64:
        return self._points[row]

    def _row(self, stamp: int) -> int | None:
        if not self._stamps:
            return None
        row = int(np.abs(np.array(self._stamps, np.int64) - stamp).argmin())
        return row if abs(self._stamps[row] - stamp) <= self.reach_ns else None


class VoxelTruth(_Sampled):
    """Exact moving voxels that a log carries, kept as such: a long log's centres would fill the memory."""

    source = TRUTH_OCCUPANCY
    reach_ns = STALE_NS

    def __init__(self, log: LogReader) -> None:
        super().__init__()
        self._voxels: list[tuple[Grid, UInt32]] = []
        for message in log.messages([TRUTH_OCCUPANCY]):
            occupancy = convert.occupancy_from_message(message.message)
            grid, indices = occupancy.grid, occupancy.layers[0].indices.copy()  # and not the message that holds them
            self._stamps.append(occupancy.stamp)
            self._voxels.append((grid, indices))
            self._volumes.append(len(indices) * litres_per_voxel(grid))

    def _points_of(self, row: int) -> Float64:
        grid, indices = self._voxels[row]
        return grid.centers(indices)

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

    def observe(self, state: TwinState, seen: Occupancy) -> None:
        """Takes in what was seen to move, and the moving masks of the views; of either the last 64 are kept."""
        self.remember_layer(state.stamp, seen)
        for view, mask in zip(state.frames.views, state.moving_masks, strict=True):
            self._masks[view.camera.name, view.stamp] = mask
        while len(self._masks) > 64:
            del self._masks[next(iter(self._masks))]

    def remember(self, stamp: int, points: Float64, volume_l: float) -> None:
        """Takes in what was seen to move at a stamp, ns; the last 64 are kept."""
        super().remember(stamp, points, volume_l)
        del self._stamps[:-64], self._points[:-64], self._volumes[:-64]

    def pixels(self, view: View) -> Bool | None:
        """[H, W] the moving mask of the view."""
        return self._masks.get((view.camera.name, view.stamp))
