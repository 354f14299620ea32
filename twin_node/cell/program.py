"""An arm that runs its program at the speed it is told, and takes as long to stop as its table says."""

from __future__ import annotations

from collections import deque

import numpy as np

from twin_node.arm import CyclicPath, StoppingTable, sample_path
from twin_node.arm.path import AHEAD_NS
from twin_node.scene import Float64, JointPath, JointSample

_DIFFERENCE_NS = 8_000_000
"""Step of the difference that gives joint speeds: one sample of the path."""
_AHEAD_OFFSETS_NS = np.arange(0, AHEAD_NS + 1, 25_000_000)
"""Times ahead at which the path is given, ns: twice as many as the law looks at."""


class RunningProgram:
    """Where an arm is in a cycle whose speed is scaled from outside, as by a controller's speed slider.

    What it is told takes effect after the command's latency. It then speeds up at once, since the speed limiter already
    raises the speed slowly, and brakes steadily so that a stop takes the time of the stopping table: the arm's worst
    case (full reach, full payload).
    """

    def __init__(self, cycle: CyclicPath, table: StoppingTable, start_ns: int, command_latency_ns: int) -> None:
        self.cycle = cycle
        self.now = start_ns
        self.phase_ns = 0.0
        """Time gone through of the program, ns."""
        self.share = 0.0
        """Speed as a share of the program's."""
        self._table = table
        self._latency_ns = command_latency_ns
        self._told: deque[tuple[int, float]] = deque()
        self._target = 0.0

    @property
    def q(self) -> Float64:
        """Joint angles [J], rad."""
        return self.cycle.at(round(self.phase_ns))

    @property
    def joints(self) -> JointSample:
        """What is measured of it now."""
        return JointSample(self.now, self.cycle.template.names, self.q, self.share * self._velocities())

    def ahead(self) -> JointPath:
        """The next 200 ms at the program's full speed."""
        template = self.cycle.template
        phases = (round(self.phase_ns) + _AHEAD_OFFSETS_NS) % self.cycle.period_ns
        return JointPath(template.names, self.now + _AHEAD_OFFSETS_NS, sample_path(template, phases))

    def speeds(self) -> Float64:
        """Joint speeds [J] of the program here, at full speed, rad/s, none of them negative."""
        return np.abs(self._velocities())

    @property
    def told(self) -> float:
        """Largest share that it obeys, or will when what it was told takes effect."""
        return max([self._target, *(share for _, share in self._told)])

    def tell(self, share: float) -> None:
        """Takes a speed, to be applied after the command's latency."""
        self._told.append((self.now + self._latency_ns, share))

    def step(self, step_ns: int) -> None:
        """Goes on for a time."""
        while self._told and self._told[0][0] <= self.now:
            self._target = self._told.popleft()[1]
        if self._target >= self.share:
            before = self.share = self._target
        else:
            stop_s = self._table.stop(self.speeds()).duration_s
            fall = step_ns * 1e-9 / stop_s if stop_s > 0 else 1.0
            before, self.share = self.share, max(self._target, self.share - fall)
        self.phase_ns += (before + self.share) / 2 * step_ns
        self.now += step_ns

    def _velocities(self) -> Float64:
        """Joint velocities [J] of the program here, at full speed, rad/s."""
        period, phase = self.cycle.period_ns, round(self.phase_ns)
        before, after = sample_path(self.cycle.template, np.array([phase % period, (phase + _DIFFERENCE_NS) % period]))
        velocities: Float64 = (after - before) / (_DIFFERENCE_NS * 1e-9)
        return velocities


def longest_stop_ns(cycle: CyclicPath, table: StoppingTable) -> int:
    """How long the longest stop from anywhere in a cycle takes, ns."""
    template = cycle.template
    speeds = np.abs(np.diff(template.positions, axis=0)) / (np.diff(template.stamps)[:, None] * 1e-9)
    windows = [speeds[row : row + AHEAD_NS // _DIFFERENCE_NS].max(axis=0) for row in range(0, len(speeds), 5)]
    return round(1e9 * max(table.stop(window).duration_s for window in windows))
