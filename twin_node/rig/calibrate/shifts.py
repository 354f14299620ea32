"""The shift in time at which two accounts of the same motion disagree least, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Bool, Float64

WINDOW_S = 5.0
"""Offsets of windows this long tell the rate, s."""
LEAST_WINDOWS = 4
"""Windows below which a rate is not told."""
PARTS = 8
"""Parts of a recording that are left out in turn to see how much the result depends on each (jackknife)."""


@dataclass(frozen=True)
class Costs:
    """How badly every instant fits at every shift."""

    stamps: NDArray[np.int64]
    """[T] ns."""
    shifts_s: Float64
    """[D] tried, evenly spaced, s."""
    values: Float64
    """[T, D]."""


@dataclass(frozen=True)
class Shift:
    """What must be added to a camera's stamps."""

    offset_ns: int
    """At the middle of the recording."""
    sigma_ns: int
    """1 sigma, from how much the offset depends on single parts of the recording."""
    rate_ppm: float | None
    """Growth of the offset; None where there are too few windows."""
    contrast: float
    """How much worse the median shift fits than the best, as a share of the best."""


def best_shift(costs: Costs) -> Shift | None:
    """The shift of least cost; None where it lies at the end of what was tried, or nothing was."""
    if len(costs.stamps) < PARTS:
        return None
    offset = _lowest(costs, np.ones(len(costs.stamps), dtype=bool))
    if offset is None:
        return None
    total = costs.values.sum(0)
    contrast = float(np.median(total) / max(float(total.min()), 1e-12) - 1)
    sigma = _jackknife(costs, offset)
    return Shift(round(offset * 1e9), round(sigma * 1e9), _rate_ppm(costs), contrast)


def _lowest(costs: Costs, rows: Bool) -> float | None:
    """The shift of least cost over some instants, by a parabola through the lowest three; None at the ends."""
    total = costs.values[rows].sum(0)
    best = int(total.argmin())
    if best in (0, len(total) - 1):
        return None
    low, middle, high = total[best - 1 : best + 2]
    bend = low - 2 * middle + high
    step = float(costs.shifts_s[1] - costs.shifts_s[0])
    return float(costs.shifts_s[best]) + (0.0 if bend <= 0 else 0.5 * float(low - high) / float(bend) * step)


def _jackknife(costs: Costs, offset: float) -> float:
    part = np.arange(len(costs.stamps)) * PARTS // len(costs.stamps)
    without = [_lowest(costs, part != i) for i in range(PARTS)]
    found = np.array([offset if value is None else value for value in without])
    return float(np.sqrt((PARTS - 1) / PARTS * ((found - found.mean()) ** 2).sum()))


def _rate_ppm(costs: Costs) -> float | None:
    """Slope of the offsets of windows over time (Theil and Sen: the median of all slopes), parts per million."""
    t = (costs.stamps - costs.stamps[0]) / 1e9
    windows = (t // WINDOW_S).astype(np.int64)
    found = [(float(t[windows == i].mean()), _lowest(costs, windows == i)) for i in np.unique(windows)]
    known = [(time, offset) for time, offset in found if offset is not None]
    if len(known) < LEAST_WINDOWS:
        return None
    times, offsets = np.array(known).T
    i, j = np.triu_indices(len(times), 1)
    return float(np.median((offsets[j] - offsets[i]) / (times[j] - times[i]))) * 1e6
