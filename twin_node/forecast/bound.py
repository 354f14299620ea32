"""How far from its forecast place a part may be: a bound calibrated online on what came true."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from twin_node.scene import Float64


@dataclass(frozen=True)
class BoundParameters:
    """Target and manners of the calibrated bound."""

    coverage: float = 0.99
    """Share of the moving space that the forecast made for it must have held."""
    acceleration: float = 8.0
    """Largest acceleration taken into account before there is a record, m/s^2: a hand starting a reach."""
    grow: float = 12.0
    """Relative growth of the radius per unit of coverage missed, per horizon: misses show one horizon late."""
    shrink: float = 0.15
    """Relative shrinkage per horizon while the target is kept: a surprise is remembered for about a second."""
    resolution: float = 0.015
    """Part of the radius at the last horizon that no record takes away, m: three quarters of a voxel."""
    error_share: float = 0.5
    """Weight of a part's own recent error in its scale."""
    speed_share: float = 0.3
    """Weight of the way that a part goes within the horizon in its scale: what is fast may stop or turn."""
    least_factor: float = 0.7
    """Smallest common factor."""
    most_factor: float = 6.0
    """Largest common factor."""
    largest_speed: float = 1.6
    """No radius exceeds what a person covers at this speed, m/s (ISO 13855)."""


class Bound:
    """Radius = a part's own scale x one factor shared by all, adapted until the target coverage is kept.

    Adaptive conformal inference (Gibbs and Candes 2021) on a multiplicative scale: the factor grows with each missed
    share and shrinks slowly while the target is kept.
    """

    def __init__(self, parameters: BoundParameters | None = None) -> None:
        self.parameters = parameters or BoundParameters()
        self.factor = 1.0
        self._limits = (self.parameters.least_factor, self.parameters.most_factor)
        self._covered: deque[float] = deque(maxlen=120)

    @property
    def coverage(self) -> float:
        """Mean share that the forecasts held over the last 120 judged image sets; NaN before the first."""
        return float(np.mean(self._covered)) if self._covered else float("nan")

    def observe(self, covered: float, elapsed: float) -> None:
        """Takes in the share [0, 1] of now moving space that lay inside the forecast made for now.

        `elapsed` is the time since the last observation in horizons.
        """
        self._covered.append(covered)
        missed = (1 - covered) - (1 - self.parameters.coverage)
        rate = self.parameters.grow * missed if missed > 0 else -self.parameters.shrink
        self.factor = float(np.clip(self.factor * np.exp(rate * min(elapsed, 1.0)), *self._limits))

    def radii(self, errors: Float64, speeds: Float64, ages: Float64, horizons: Float64) -> Float64:
        """Radii [H, M] in metres of parts with recent errors [M] (m, at the last horizon) and speeds [M].

        Parts whose record of `ages` [M] (s) is shorter than the last horizon get the reachable set instead: a h^2 / 2
        about the place that their velocity takes them to.
        """
        p = self.parameters
        scale = p.resolution + p.error_share * errors + p.speed_share * speeds * horizons[-1]
        calibrated = self.factor * scale * (horizons / horizons[-1])[:, None]
        reachable = p.acceleration * horizons[:, None] ** 2 / 2
        radii: Float64 = np.where(ages >= horizons[-1], calibrated, np.maximum(calibrated, reachable))
        return np.minimum(radii, p.largest_speed * horizons[:, None])
