"""Tracks: the paths of nodes, continued from sample to sample."""

from __future__ import annotations

import numpy as np

from twin_node.forecast.experts import History
from twin_node.forecast.nearest import nearest
from twin_node.forecast.parts import PART_SIZE
from twin_node.forecast.prediction import Association
from twin_node.forecast.records import Rows
from twin_node.scene import Float64

REACH = 1.5 * PART_SIZE
"""A part is taken for the one whose place is at most this far off, m, and continues its track."""
KIN = 0.3
"""A new part takes over the record of errors of a part this near, m: a hull changes shape at its rims."""
KEPT_S = 1.0
"""Paths are kept so long, s: the longest horizon and the steps that forecasts look back on."""
MOST_SPEED = 15.0
"""What is further off than this speed allows is something else, m/s: half as fast again as a throw overarm."""
JUMP = 0.3
"""Leaps shorter than this are motion at any rate, m."""
ONE_TIME_S = 1e-6
"""Samples no further apart are of one time, s: over less, noise of millimetres would be a speed of kilometres."""


class Tracks:
    """Paths of M nodes over the last T samples; arrays are re-indexed as nodes follow nodes."""

    def __init__(self) -> None:
        self.times = np.zeros(0)
        """[T] s."""
        self.positions = np.zeros((0, 0, 3))
        """[T, M, 3] m."""
        self.velocities = np.zeros((0, 3))
        """[M, 3] m/s, as measured or from the last step."""
        self.born = np.zeros(0)
        """[M] s when each path began."""

    @property
    def history(self) -> History:
        """The paths as the experts see them."""
        return History(self.times, self.positions)

    @property
    def count(self) -> int:
        """M."""
        return len(self.velocities)

    def extend(self, time: float, positions: Float64, rows: Rows) -> Association:
        """Continues paths to known nodes at `positions` [M', 3] (m), at `time` (s).

        `rows` [M']: the row that each node had at the sample before; -1 for new ones. What leaps begins anew.
        """
        step = time - self.times[-1] if len(self.times) else 0.0
        last = np.append(self.positions[-1] if len(self.times) else np.zeros((0, 3)), np.zeros((1, 3)), axis=0)[rows]
        leaps = np.linalg.norm(positions - last, axis=1) > np.maximum(MOST_SPEED * step, JUMP)
        rows = np.where(leaps, -1, rows)
        moved = np.where(rows[:, None] < 0, 0, positions - last)
        self._go_on(time, rows, positions, positions, shift=False)
        self.velocities = moved / step if step > ONE_TIME_S else np.zeros_like(moved)
        return Association(rows, rows)

    def follow(self, time: float, centers: Float64, velocities: Float64) -> Association:
        """Continues paths into parts at `centers` [M', 3] (m) that move at `velocities` [M', 3] (m/s), at `time` (s).

        A part is a cell of a lattice, not a body: its path is that of the part which was where it came from, moved so
        that the last step is what its velocity says.
        """
        step = time - self.times[-1] if len(self.times) else 0.0
        places = centers - velocities * step
        rows, kin = self._nearest(places)
        self._go_on(time, rows, places, centers, shift=True)
        self.velocities = velocities
        return Association(rows, kin)

    def _nearest(self, places: Float64) -> tuple[Rows, Rows]:
        """Row [n] of the node nearest to each place, within `REACH` and within `KIN`; -1 where there is none."""
        if self.count == 0:
            none = np.full(len(places), -1, np.int64)
            return none, none
        distances, found = nearest(places, self.positions[-1], within=KIN)
        kin = np.where(found[:, 0] == self.count, -1, found[:, 0])
        return np.where(distances[:, 0] < REACH, kin, -1), kin

    def _go_on(self, time: float, rows: Rows, before: Float64, positions: Float64, shift: bool) -> None:
        """Takes in where nodes are at `time`, `positions` [M', 3], and re-indexes their paths by rows.

        New nodes have stood at `before` [M', 3]; `shift` moves the paths of others there too.
        """
        new, kept = rows < 0, int(np.searchsorted(self.times, time - KEPT_S))
        samples = len(self.times) - kept
        paths = np.empty((samples + 1, len(rows), 3))
        if self.count == 0:
            paths[:-1] = before
            self.born = np.full(len(rows), time)
        else:
            np.take(self.positions[kept:], rows, axis=1, out=paths[:-1], mode="wrap")
            paths[:-1, new] = before[new]
            if shift and samples:
                paths[:-1] += before - paths[-2]
            self.born = np.where(new, time, self.born[rows])
        paths[-1] = positions
        times = np.append(self.times[kept:], time)
        is_last = np.append(np.diff(times) > ONE_TIME_S, True)  # of one time the later sample holds
        self.positions, self.times = (paths, times) if is_last.all() else (paths[is_last], times[is_last])
