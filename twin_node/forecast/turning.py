"""What may turn back: held along all of its way, from as far behind where it is as it is expected to go ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.growth import Points
from twin_node.forecast.parts import PART_SIZE
from twin_node.scene import Bool, Float64

NARROWER = 0.5
"""Radius along the way as a share of that at its end: what turns back goes where it came from."""
MOST_STEPS = 32
"""Steps of a part's size that a way is taken in at most: both ways at 5 m/s; those of faster things are longer."""


@dataclass(frozen=True)
class Ways:
    """Where points will be, and how far from there at most."""

    points: Points
    displacements: Float64
    """[H, P, 3] m, of the parts that the points are labelled with."""
    radii: Float64
    """[H, P] m."""


def whole_ways(points: Points, displacements: Float64, radii: Float64, turning: Bool) -> Ways:
    """The parts of `points`, displaced by [H, M, 3] with radii [H, M] (m), those `turning` [M] all along their ways.

    Each of these is repeated, under labels of its own, from behind to ahead of where it is.
    """
    rows = np.flatnonzero(turning)
    if len(rows) == 0:
        return Ways(points, displacements, radii)
    longest = 2 * float(np.linalg.norm(displacements[-1, rows], axis=-1).max())
    steps = min(int(np.ceil(longest / PART_SIZE)), MOST_STEPS)
    shares = 1 - 2 * np.arange(1, steps + 1) / max(steps, 1)
    mine = np.flatnonzero(turning[points.labels])
    number = np.cumsum(turning) - 1
    firsts = len(turning) + len(rows) * np.arange(steps)
    repeated = Points(
        np.concatenate([points.places, np.tile(points.places[:, mine], steps)], axis=1),
        np.concatenate([points.labels, (firsts[:, None] + number[points.labels[mine]]).reshape(-1)]),
        np.concatenate([points.core, np.zeros(steps * len(mine), np.bool_)]),
    )
    between = (shares[:, None, None] * displacements[:, None, rows]).reshape(len(displacements), -1, 3)
    narrow = np.tile(NARROWER * radii[:, rows], steps)
    return Ways(repeated, np.concatenate([displacements, between], axis=1), np.concatenate([radii, narrow], axis=1))


def off_the_way(ahead: Float64, moved: Float64) -> Float64:
    """Distances [n] of displacements `moved` [n, 3] from the straight ways between those `ahead` [n, 3] and behind."""
    squares = np.maximum((ahead**2).sum(axis=-1), 1e-12)
    shares = np.clip((moved * ahead).sum(axis=-1) / squares, -1, 1)
    distances: Float64 = np.linalg.norm(moved - shares[:, None] * ahead, axis=-1)
    return distances
