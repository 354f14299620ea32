"""Boxes that stand cut where regions of allowed contacts end: how a cover groups what stands says nothing of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin_node.arm.attachment import AllowedRegion
from twin_node.arm.obstacle_set import FLUSH_M
from twin_node.scene import Bool, ObstacleKind, Obstacles, ObstacleShape


def cut_at(obstacles: Obstacles, regions: Sequence[AllowedRegion], most: int) -> Obstacles:
    """The same obstacles, those that stand and reach into a region in pieces that lie inside or outside of it.

    Pieces have all of their box but its place and size. Boxes aslant and spheres stay whole, and so does everything
    where there would be more than `most` boxes: the arm then keeps away from more than it must.
    """
    pieces = obstacles
    for region in regions:
        for axis in range(3):
            for face in (float(region.lower[axis]), float(region.upper[axis])):
                pieces = _cut(pieces, region, axis, face)
    boxes = int((pieces.shapes == ObstacleShape.BOX).sum())
    return pieces if boxes <= most else obstacles


def _cut(obstacles: Obstacles, region: AllowedRegion, axis: int, face: float) -> Obstacles:
    """Boxes along the axes that stand and reach into the region, in two where its face (m) on an axis crosses them."""
    lower, upper = obstacles.positions - obstacles.sizes / 2, obstacles.positions + obstacles.sizes / 2
    crossed = (lower[:, axis] < face - FLUSH_M) & (upper[:, axis] > face + FLUSH_M)
    crossed &= _may_be_cut(obstacles) & ((lower < region.upper) & (upper > region.lower)).all(axis=1)
    if not crossed.any():
        return obstacles
    rows = np.repeat(np.arange(len(crossed)), 1 + crossed)
    begins, ends = lower[rows], upper[rows]
    second = np.append(False, rows[1:] == rows[:-1])
    first = np.append(second[1:], False)
    ends[first, axis] = begins[second, axis] = face
    return replace(obstacles.only(rows), positions=(begins + ends) / 2, sizes=ends - begins)


def _may_be_cut(obstacles: Obstacles) -> Bool:
    """[n] boxes that stand, along the axes of `base_link`."""
    along = ~obstacles.quats[:, 1:].any(axis=1)
    stands = (obstacles.kinds == ObstacleKind.STATIC) & (obstacles.shapes == ObstacleShape.BOX)
    return np.asarray(stands & along)
