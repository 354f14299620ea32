"""The arm's joints as they were told, and where they were at a set's time."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin_node.scene import JointSample

MOST_GAP_NS = 100_000_000
"""Joints further from a set's stamp than this are not its own."""
KEPT_NS = 2_000_000_000
"""Samples stamped further than this from the one that came last are dropped: longer than any set waits."""
LEAST_STEP_NS = 1_000_000
"""Of two samples that are closer in time the stamps' jitter would be taken for speed."""


class ToldJoints:
    """Samples of one arm's joints, of the last moments."""

    def __init__(self) -> None:
        self._samples: list[JointSample] = []
        self._tells_velocities = False
        """Whether any ever told a velocity other than 0, which many put there who measure none."""

    def add(self, sample: JointSample) -> None:
        """Takes the joints at one time, in any order of stamps; a clock that was put back is followed."""
        self._tells_velocities |= bool(sample.velocities.any())
        insort(self._samples, sample, key=lambda s: s.stamp)
        while self._samples[0].stamp < sample.stamp - KEPT_NS:
            self._samples.pop(0)
        while self._samples[-1].stamp > sample.stamp + KEPT_NS:
            self._samples.pop()

    def near(self, stamp: int) -> JointSample | None:
        """The joints at a stamp, ns, between those before and after it; the nearest where only one of these is near: it
        keeps its time, by which it is old. None where neither is.

        Where no joints ever tell how fast they are, they are as fast as these two, or the last two, say.
        """
        place = bisect_left(self._samples, stamp, key=lambda s: s.stamp)
        until = self._samples[max(place - 2, 0) : place]
        is_before = bool(until) and stamp - until[-1].stamp <= MOST_GAP_NS
        is_after = place < len(self._samples) and self._samples[place].stamp - stamp <= MOST_GAP_NS
        if is_before and is_after:
            steps = [until[-1], self._samples[place]]
            found = _between(steps[0], steps[1], stamp)
        elif is_before:
            steps, found = until, until[-1]
        else:
            return self._samples[place] if is_after else None
        return found if self._tells_velocities else _as_fast(found, steps)


def _as_fast(sample: JointSample, steps: Sequence[JointSample]) -> JointSample:
    """A sample without velocities with those from the first of two samples to the second, where these tell."""
    if len(steps) < 2 or not _follow(steps[0], steps[1]):
        return sample
    passed_ns = steps[1].stamp - steps[0].stamp
    if not LEAST_STEP_NS <= passed_ns <= 2 * MOST_GAP_NS:
        return sample
    return replace(sample, velocities=(steps[1].positions - steps[0].positions) / (passed_ns * 1e-9))


def _between(before: JointSample, after: JointSample, stamp: int) -> JointSample:
    """The joints at a stamp, ns, after that of one sample and up to that of the next; the nearer one where these do not
    follow each other."""
    if not _follow(before, after):
        return before if 2 * stamp < before.stamp + after.stamp else after
    share = (stamp - before.stamp) / (after.stamp - before.stamp)
    positions, velocities = (
        (1 - share) * a + share * b
        for a, b in ((before.positions, after.positions), (before.velocities, after.velocities))
    )
    return JointSample(stamp, before.names, positions, velocities)


def _follow(before: JointSample, after: JointSample) -> bool:
    """Whether two samples are of the same joints, none of which has turned by half a turn meanwhile: some drivers count
    joints without limits within one turn."""
    return before.names == after.names and np.abs(after.positions - before.positions).max(initial=0.0) <= math.pi
