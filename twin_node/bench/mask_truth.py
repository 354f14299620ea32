"""What truly moves in the images of a simulated cell, part by part."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from twin_node.bench.mask_scores import ImageTruth
from twin_node.cell import SimulatedRig
from twin_node.scene import Bool, Float64, View

MOVED_M = 0.01
"""A part no corner of which has gone farther has not moved: less than a pixel of a camera 160 wide, 1.5 m away."""
RECENT_NS = 1_000_000_000
"""What has moved within this time counts as moving: the model takes as long to call it STATIC."""


class MovingParts:
    """Which pixels show what moves, by the cell's own geometry.

    A part is one rigid piece of a moving body or a person: a parcel, a ball, a forearm, a trunk. It is *moving* while
    some corner of its box was more than `MOVED_M` (along an axis) from where it is now in a set of the last
    `RECENT_NS`. One that moved before that has *rested*; one that has never moved since the first set is *waiting*.
    The arm is none of them.
    """

    def __init__(self, simulated: SimulatedRig) -> None:
        self._simulated = simulated
        self._rows = {camera.name: row for row, camera in enumerate(simulated.cameras)}
        self._past: deque[tuple[int, Float64]] = deque()
        self._moving = self._has_moved = np.zeros(len(self._corners(simulated.scenario.start_ns)), np.bool_)

    def advance(self, stamp: int) -> None:
        """Goes on to the set of a stamp, ns; sets come in rising order."""
        now = self._corners(stamp)
        self._past.append((stamp, now))
        while stamp - self._past[0][0] > RECENT_NS:
            self._past.popleft()
        ways = [np.abs(now - before).max(axis=(1, 2)) for _, before in self._past]
        self._moving = np.max(ways, axis=0) > MOVED_M
        self._has_moved = self._has_moved | self._moving

    def shown(self, view: View) -> ImageTruth:
        """What one image of the set that was last gone on to shows of the parts."""
        world = self._simulated.world
        first = len(world.names)  # owners below are furniture and the arm
        parts = tuple(replace(solid, owner=first + part) for part, solid in enumerate(world.moving(view.stamp)))
        renderer = self._simulated.renderers[self._rows[view.camera.name]]
        owners = renderer.render((*parts, *world.arm_solids(view.stamp))).owners

        def of(kind: Bool) -> Bool:
            return np.isin(owners, first + np.flatnonzero(kind))

        return ImageTruth(of(self._moving), of(~self._moving & self._has_moved), of(~self._has_moved))

    def _corners(self, stamp: int) -> Float64:
        """[parts, 8, 3] m."""
        return np.array([solid.placed.corners for solid in self._simulated.world.moving(stamp)]).reshape(-1, 8, 3)
