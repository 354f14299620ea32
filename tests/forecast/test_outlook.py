"""What experts make of nodes: compiled as by the reference."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.forecast.bound import CUES
from twin_node.forecast.experts import EXPERT_NAMES, FEATURES, History
from twin_node.forecast.outlook import Standing, outlook, outlook_reference

EXPERTS = len(EXPERT_NAMES)


def paths(rng: np.random.Generator, count: int, samples: int) -> History:
    """Of nodes in a space of two metres, with gaps of several lengths between samples."""
    times = 7.0 + np.cumsum(rng.choice([0.016, 0.033, 0.05], samples))
    begin = rng.uniform(-1, 1, (1, count, 3))
    return History(times, begin + np.cumsum(rng.normal(0, 0.02, (samples, count, 3)), axis=0))


def standing(rng: np.random.Generator, count: int) -> Standing:
    return Standing(
        rng.uniform(0, 0.05, (EXPERTS, count)),
        rng.uniform(0, 0.2, count),
        rng.uniform(0.2, 1, EXPERTS),
        rng.choice([-1, -1, 1, EXPERTS - 1], count),
    )


@pytest.mark.parametrize("samples", [1, 2, 3, 5, 30])
@pytest.mark.parametrize("count", [0, 1, 2, 9, 150])
def test_compiled_as_reference(count: int, samples: int) -> None:
    rng = np.random.default_rng(100 * samples + count)
    history, given = paths(rng, count, samples), standing(rng, count)
    plain = History(history.times, history.positions)
    floors = np.where(rng.random(count) < 0.5, -np.inf, rng.uniform(-1, 0, count))
    horizons = np.array([0.05, 0.1, 0.2])
    learnt = rng.normal(0, 0.3, (len(horizons), FEATURES))
    found = outlook(history, given, floors, learnt, horizons)
    expected = outlook_reference(plain, given, floors, learnt, horizons)
    assert found.cues.shape == (count, CUES)
    for name in ("features", "shares", "cues"):
        assert np.allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-12), name
    assert np.allclose(found.led.single, expected.led.single, rtol=1e-9, atol=1e-12)
    assert np.allclose(found.led.mixed, expected.led.mixed, rtol=1e-9, atol=1e-12)
    for name in ("line", "parabola", "falling"):
        assert np.allclose(getattr(history, name), getattr(plain, name), rtol=1e-9, atol=1e-11), name


def test_who_leads_alone_leads_alone() -> None:
    rng = np.random.default_rng(0)
    history, given = paths(rng, 20, 12), standing(rng, 20)
    found = outlook(history, given, np.full(20, -np.inf), np.zeros((1, FEATURES)), np.array([0.2]))
    rows = np.flatnonzero(given.alone >= 0)
    assert len(rows) > 0
    assert np.allclose(found.led.mixed[0, rows], found.led.single[given.alone[rows], 0, rows])


def test_neighbours_share_what_they_know_of_the_experts() -> None:
    history = paths(np.random.default_rng(1), 2, 4)
    history = History(history.times, 0 * history.positions)
    squared = np.full((EXPERTS, 2), 0.04)
    squared[1, 0] = 0.0
    given = Standing(squared, np.zeros(2), np.ones(EXPERTS), np.full(2, -1))
    shares = outlook(history, given, np.full(2, -np.inf), np.zeros((1, FEATURES)), np.array([0.2])).shares
    assert shares[1, 0] > shares[1, 1] > shares[0, 1]
