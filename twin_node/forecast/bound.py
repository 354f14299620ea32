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
    grow: float = 4.0
    """Relative growth of the radius per unit of coverage missed, per image set."""
    shrink: float = 0.02
    """Relative shrinkage per image set while the target is kept: a surprise is remembered for seconds."""
    largest_speed: float = 1.6
    """No radius exceeds what a person covers at this speed, m/s (ISO 13855)."""


class Bound:
    """Radius = a part's own recent error x one factor shared by all, adapted until the target coverage is kept.

    Adaptive conformal inference (Gibbs and Candes 2021) on a multiplicative scale: the factor grows with each missed
    share and shrinks slowly while the target is kept.
    """

    def __init__(self, parameters: BoundParameters | None = None) -> None:
        self.parameters = parameters or BoundParameters()
        self.factor = 1.0
        self._covered: deque[float] = deque(maxlen=120)

    @property
    def coverage(self) -> float:
        """Mean share that the forecasts held over the last 120 judged image sets; NaN before the first."""
        return float(np.mean(self._covered)) if self._covered else float("nan")

    def observe(self, covered: float) -> None:
        """Takes in the share [0, 1] of now moving space that lay inside the forecast made for now."""
        self._covered.append(covered)
        missed = (1 - covered) - (1 - self.parameters.coverage)
        rate = self.parameters.grow * missed if missed > 0 else -self.parameters.shrink
        self.factor = float(np.clip(self.factor * (1 + rate), 0.3, 6.0))

    def radii(self, errors: Float64, speeds: Float64, ages: Float64, horizons: Float64, judged_s: float) -> Float64:
        """Radii [H, M] in metres of parts with recent errors [M] (m, at the horizon `judged_s`) and speeds [M].

        Parts of age [M] less than `judged_s` have no record: theirs is the reachable set |v| h + a h^2 / 2.
        """
        share = (horizons / judged_s)[:, None]
        calibrated = self.factor * errors * share
        reachable = speeds * horizons[:, None] * 0.5 + self.parameters.acceleration * horizons[:, None] ** 2 / 2
        radii = np.where(ages >= judged_s, calibrated, np.maximum(calibrated, reachable))
        return np.minimum(radii, self.parameters.largest_speed * horizons[:, None])
