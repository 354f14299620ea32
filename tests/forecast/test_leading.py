"""Where experts lead nodes: compiled as by the reference."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.forecast.experts import EXPERT_NAMES, FEATURES, History
from twin_node.forecast.leading import Guides, led, led_reference


@pytest.mark.parametrize("floor", [-np.inf, 0.3])
@pytest.mark.parametrize(("count", "samples"), [(0, 3), (1, 1), (7, 2), (120, 12)])
def test_compiled_as_reference(count: int, samples: int, floor: float) -> None:
    rng = np.random.default_rng(count)
    paths = History(0.033 * np.arange(samples), np.cumsum(rng.normal(0, 0.05, (samples, count, 3)), axis=0))
    floors = floor + rng.normal(0, 0.1, count)
    guides = Guides(paths, rng.normal(0, 0.02, (count, 3, FEATURES)), floors)
    horizons = np.array([0.03, 0.1, 0.25])
    weights, learnt = rng.random((len(EXPERT_NAMES), count)), rng.normal(size=(len(horizons), FEATURES))
    found, expected = (one(guides, learnt, weights, horizons) for one in (led, led_reference))
    assert found.single.shape == (len(EXPERT_NAMES), len(horizons), count, 3)
    assert np.allclose(found.single, expected.single, rtol=1e-12, atol=1e-14)
    assert np.allclose(found.mixed, expected.mixed, rtol=1e-12, atol=1e-14)
    free = led(Guides(paths, guides.features, np.full(count, -np.inf)), learnt, weights, horizons)
    assert np.array_equal(found.single, free.single) == (floor < 0 or count == 0)
