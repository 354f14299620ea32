"""How much a set stands for: where sets come more rarely than usual, more has changed from one to the next."""

from __future__ import annotations

USUAL_PERIOD_S = 1 / 15
"""Time between two sets, s, up to which what is meant per set is done per set."""


def usual_periods(elapsed_s: float) -> float:
    """Usual periods in the time from the set before, one at least."""
    return max(elapsed_s / USUAL_PERIOD_S, 1.0)
