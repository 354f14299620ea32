"""Elastic jelly and ghosts: how far rigid things are bent, and what is left where something has been."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from twin_node.model.quality import squared_error
from twin_node.scene import Bool, Float32, Float64, GaussianCloud, Tier, UInt8

ISOMETRY_NS = 200_000_000
"""Distances are compared with those of so long ago: the forecast's horizon, ns."""
PAIR_M = (0.03, 0.3)
"""Distances that are compared, m: shorter ones are noise, longer ones leave the thing."""
PAIRS = 400
"""So many pairs per tick, where there are as many; less than twice as many."""
LEAST_PAIRS = 20
LEFT_NS = 100_000_000
"""What covered a pixel so long ago and no longer does has just left it, ns."""
LEAST_EDGE = 0.01
"""Mean squared contrast (of 0 to 1) of thing and background from which a ghost can be told."""


@dataclass(frozen=True)
class Shape:
    """What was found over a run; None where nothing could be compared."""

    isometry_error: float | None
    """Mean change of the distance of two Gaussians of a rigid thing within 200 ms, as a share; the truth is 0."""
    isometry_error_mm: float | None
    ghost: dict[str, float] = field(default_factory=dict)
    """Per way to make pictures: energy left where something has just been, over its own; 1 is a whole ghost."""


class Isometry:
    """Compares distances between the same moving Gaussians over time."""

    def __init__(self) -> None:
        self._past: deque[GaussianCloud] = deque()
        self._stamps: deque[int] = deque()
        self.shares: list[float] = []
        self.lengths_m: list[float] = []

    def add(self, stamp: int, cloud: GaussianCloud) -> None:
        """Takes in a cloud, ns; those of Gaussians that move with a node count."""
        now = cloud.only((cloud.tiers == Tier.RIGID) | (cloud.tiers == Tier.DEFORMABLE))
        self._past.append(now)
        self._stamps.append(stamp)
        while self._stamps[-1] - self._stamps[0] > ISOMETRY_NS:
            self._stamps.popleft()
            self._past.popleft()
        if stamp - self._stamps[0] > 0.8 * ISOMETRY_NS:
            self._compare(self._past[0], now)

    def _compare(self, then: GaussianCloud, now: GaussianCloud) -> None:
        _, before, after = np.intersect1d(then.ids, now.ids, return_indices=True)
        was, here = then.means[before].astype(np.float64), now.means[after].astype(np.float64)
        pairs = _pairs(was)
        if len(pairs) < LEAST_PAIRS:
            return
        old, new = _lengths(was, pairs), _lengths(here, pairs)
        self.shares.append(float(np.mean(np.abs(new - old) / old)))
        self.lengths_m.append(float(np.mean(np.abs(new - old))))


def _pairs(points: Float64) -> Float64:
    """[n, 2] rows of points whose distance lies within `PAIR_M`, evenly thinned."""
    if len(points) < 2:
        return np.zeros((0, 2), np.int64)
    pairs = cKDTree(points).query_pairs(PAIR_M[1], output_type="ndarray")
    pairs = pairs[_lengths(points, pairs) > PAIR_M[0]]
    chosen: Float64 = pairs[:: max(1, len(pairs) // PAIRS)]
    return chosen


def _lengths(points: Float64, pairs: Float64) -> Float64:
    lengths: Float64 = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    return lengths


@dataclass
class Ghosts:
    """Energy left where something has just been."""

    left: dict[str, float] = field(default_factory=dict)
    whole: float = 0.0

    def add(self, exact: UInt8, exact_before: UInt8, left: Bool, pictures: dict[str, Float32]) -> None:
        """Takes in pictures [H, W, 3] (0 to 1) by name of a moment whose exact image is `exact`.

        `left` [H, W]: pixels that show what stands, and `LEFT_NS` ago, in `exact_before`, showed what moves.
        """
        truth, ghost = exact.astype(np.float32) / 255, exact_before.astype(np.float32) / 255
        contrast = squared_error(ghost, truth)
        chosen = left & (contrast > LEAST_EDGE)
        self.whole += float(contrast[chosen].sum())
        for name, picture in pictures.items():
            self.left[name] = self.left.get(name, 0.0) + float(squared_error(picture, truth)[chosen].sum())

    def shares(self) -> dict[str, float]:
        """Per name, what is left over what was there; empty where nothing has left anything."""
        return {name: left / self.whole for name, left in self.left.items()} if self.whole > 0 else {}
