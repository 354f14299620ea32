"""What a forecast is compared with, on the same evidence."""

from __future__ import annotations

import numpy as np
from forecast_worlds import GRID, state_of

from twin_node.forecast import BaselineForecaster

PERIOD_NS = 33_333_333
LATENCY_NS = 33_000_000


def test_no_baseline_goes_on_with_what_was_known_before_a_pause() -> None:
    """Ours does not either, and they stand on the same evidence."""
    baselines = BaselineForecaster(GRID)
    for tick in range(12):
        stamp = tick * PERIOD_NS
        at = np.array([-0.3 + stamp * 1e-9, 0.05, 0.4])
        moving = baselines.update(state_of(stamp, at), stamp + LATENCY_NS)
    later = state_of(stamp + 3_000_000_000, at)
    found = baselines.update(later, later.stamp + LATENCY_NS)
    (led, stays), (went, stayed) = (
        (one.constant_velocity.layers[-1].indices, one.persistence.layers[-1].indices) for one in (found, moving)
    )
    assert not np.array_equal(went, stayed)
    np.testing.assert_array_equal(led, stays)
