"""What a log knows to be true of its moving things, or, for want of that, what the twin saw when the time had come."""

from __future__ import annotations

import numpy as np

from twin_node.bag import LogReader
from twin_node.forecast.comparison import Truth
from twin_node.forecast.score import litres_per_voxel
from twin_node.messages import convert
from twin_node.nodes.contents import record_of
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
        self._voxels: list[tuple[Grid, UInt32]] = []
        """And not their centres, of which a long log has gigabytes."""

    def remember(self, seen: Occupancy) -> None:
        """Takes in that the first layer of `seen` moves at its stamp."""
        self._stamps.append(seen.stamp)
        self._voxels.append((seen.grid, seen.layers[0].indices.copy()))  # and not the message that holds them

    def points(self, stamp: int, evidence: int) -> Float64 | None:
        """[n, 3] centres of the moving voxels nearest in time, m, whatever had been seen of them."""
        row = self._row(stamp)
        if row is None:
            return None
        grid, indices = self._voxels[row]
        return grid.centers(indices)

    def volume_l(self, stamp: int) -> float | None:
        """Litres of the moving voxels nearest in time."""
        row = self._row(stamp)
        if row is None:
            return None
        grid, indices = self._voxels[row]
        return len(indices) * litres_per_voxel(grid)

    def _row(self, stamp: int) -> int | None:
        if not self._stamps:
            return None
        row = int(np.abs(np.array(self._stamps, np.int64) - stamp).argmin())
        return row if abs(self._stamps[row] - stamp) <= self.reach_ns else None


class VoxelTruth(_Sampled):
    """Exact moving voxels that a log carries. Raises `GraphError` naming the place where one of them is damaged."""

    source = TRUTH_OCCUPANCY
    reach_ns = STALE_NS

    def __init__(self, log: LogReader) -> None:
        super().__init__()
        for message in log.messages([TRUTH_OCCUPANCY]):
            self.remember(record_of(message, log, convert.occupancy_from_message))

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
        self.remember(seen)
        for view, mask in zip(state.frames.views, state.moving_masks, strict=True):
            self._masks[view.camera.name, view.stamp] = mask
        while len(self._masks) > 64:
            del self._masks[next(iter(self._masks))]

    def remember(self, seen: Occupancy) -> None:
        """Takes in that the first layer of `seen` moves at its stamp; the last 64 are kept."""
        super().remember(seen)
        del self._stamps[:-64], self._voxels[:-64]

    def pixels(self, view: View) -> Bool | None:
        """[H, W] the moving mask of the view."""
        return self._masks.get((view.camera.name, view.stamp))
