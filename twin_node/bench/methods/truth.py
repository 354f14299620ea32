"""Exact motion of surface points, and how far a method's own motion is from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Float64

Follow = Callable[[Float64, int], "Float64 | None"]
"""Where points [P, 3] (m) seen at the time step `begin` are at it and all later ones, [T - begin, P, 3] m; None where
a method knows no motion."""


@dataclass(frozen=True)
class MotionTruth:
    """Points of moving surfaces at every time step."""

    stamps: tuple[int, ...]
    """[T] ns."""
    positions: Float64
    """[T, P, 3] m in `base_link`."""
    births: NDArray[np.int64]
    """[P] time step at which a training camera first sees the point."""
    movers: tuple[str, ...]
    """[P] what the point is part of."""


def track_errors_mm(truth: MotionTruth, follow: Follow) -> dict[str, float]:
    """Mean distance, mm, over all later times, of points that a method follows from when they are first seen.

    Per mover, and under "all" the mean over all points. Empty where the method knows no motion.
    """
    sums = np.zeros(len(truth.births))
    counts = np.zeros(len(truth.births))
    for birth in np.unique(truth.births):
        chosen = np.flatnonzero(truth.births == birth)
        if birth == len(truth.stamps) - 1:
            continue
        found = follow(truth.positions[birth, chosen], int(birth))
        if found is None:
            return {}
        distances = np.linalg.norm(found[1:] - truth.positions[birth + 1 :, chosen], axis=-1)
        sums[chosen] += distances.sum(0)
        counts[chosen] += len(distances)
    known = counts > 0
    means = 1e3 * sums[known] / counts[known]
    movers = np.array(truth.movers)[known]
    errors = {str(name): float(means[movers == name].mean()) for name in np.unique(movers)}
    return errors | ({"all": float(means.mean())} if len(means) else {})
