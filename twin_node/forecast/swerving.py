"""What accelerates may go on to: held from where the experts lead it to where its acceleration does, if that lasts.

A foot that brakes and is about to swing back, a hand that starts: all experts that do well on average lead straight on,
and the bound about them, calibrated on all that moves, is too small to hold it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.growth import Points
from twin_node.forecast.parts import PART_SIZE
from twin_node.forecast.turning import MOST_STEPS, NARROWER, Ways
from twin_node.scene import Bool, Float64


@dataclass(frozen=True)
class Swerves:
    """Where M nodes get at H horizons if their accelerations last."""

    displacements: Float64
    """[H, M, 3] m."""
    held: Bool
    """[M] nodes that are held as far as there."""


def swerves_of(mixed: Float64, radii: Float64, accelerated: Float64, largest: float) -> Swerves:
    """Those of nodes that the experts lead by `mixed` [H, M, 3] (m), bounded by `radii` [H, M] (m).

    `accelerated` [H, M, 3]: where their accelerations lead (m), no farther from there than `largest` (m) at the last
    horizon. What stays in its bound needs no more room.
    """
    aside = accelerated - mixed
    far = np.linalg.norm(aside[-1], axis=-1)
    held = np.isfinite(far) & (far > radii[-1])
    shares = np.minimum(largest / np.where(held, far, largest), 1)
    return Swerves(mixed + np.where(held, shares, 0)[:, None] * np.where(held[:, None], aside, 0), held)


def beside(ways: Ways, points: Points, swerves: Swerves) -> Ways:
    """`ways` that begin with those of the M nodes that the cores of `points` are labelled with, and their swerves.

    Each of these cores is repeated, under labels of its own, from where its node is led to where it swerves to; its
    rim, which only errors of the carving add, is not.
    """
    rows = np.flatnonzero(swerves.held)
    led, radii = ways.displacements[:, rows], ways.radii[:, rows]
    aside = swerves.displacements[:, rows] - led
    steps = min(int(np.ceil(np.linalg.norm(aside[-1], axis=-1).max(initial=0) / PART_SIZE)), MOST_STEPS)
    if steps == 0:
        return ways
    number = np.full(ways.displacements.shape[1], -1)
    number[rows] = np.arange(len(rows))
    mine = np.flatnonzero((number[points.labels] >= 0) & points.core)
    firsts = ways.displacements.shape[1] + len(rows) * np.arange(steps)
    repeated = Points(
        np.concatenate([ways.points.places, np.tile(points.places[:, mine], steps)], axis=1),
        np.concatenate([ways.points.labels, (firsts[:, None] + number[points.labels[mine]]).reshape(-1)]),
        np.concatenate([ways.points.core, np.zeros(steps * len(mine), np.bool_)]),
    )
    shares = np.arange(1, steps + 1) / steps
    between = (led[:, None] + shares[:, None, None] * aside[:, None]).reshape(len(led), -1, 3)
    narrow = np.tile(NARROWER * radii, steps)
    return Ways(
        repeated, np.concatenate([ways.displacements, between], axis=1), np.concatenate([ways.radii, narrow], axis=1)
    )
