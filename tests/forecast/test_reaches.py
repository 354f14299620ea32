"""How far nodes may be from where they are led: compiled, the same to the bit as by NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.forecast.bound import Bound, Expected
from twin_node.forecast.kernels import kernels
from twin_node.forecast.measured import UNKNOWN_SPEED, Measured
from twin_node.forecast.reaches import Known, Span, reaches, reaches_plainly

COUNT, NOW, HORIZON_S = 400, 3.0, 0.2
HORIZONS = np.array([0.033, 0.083, 0.133, 0.183, 0.233])


def velocities(rng: np.random.Generator) -> Measured:
    flying, alone, falling = rng.random((3, COUNT)) < 0.2
    sigmas = np.minimum(rng.uniform(0, 1.3 * UNKNOWN_SPEED, COUNT), UNKNOWN_SPEED)
    return Measured(sigmas, flying, alone, falling, np.full(COUNT, -np.inf))


def known(rng: np.random.Generator, measured: Measured | None) -> Known:
    """Nodes of all kinds and ages; nothing is known of the errors of one."""
    scales = rng.uniform(0, 0.5, COUNT)
    scales[7] = np.nan
    expected = Expected(scales, rng.uniform(0, 0.4, COUNT))
    began, born = NOW - rng.uniform(0, 0.4, COUNT), NOW - rng.uniform(0, 0.6, COUNT)
    turned = np.where(rng.random(COUNT) < 0.3, NOW - rng.uniform(0, 1, COUNT), -np.inf)
    return Known(NOW, HORIZON_S, expected, born, began, turned, rng.uniform(0, 4, COUNT), measured)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("is_measured", [False, True])
@pytest.mark.parametrize("capped", [False, True])
@pytest.mark.parametrize("factor", [0.05, 1.0, 3.0])
@pytest.mark.parametrize("horizons", [HORIZONS, HORIZONS[-1:]])
def test_compiled_to_the_bit_as_plainly(horizons: np.ndarray, factor: float, capped: bool, is_measured: bool) -> None:
    rng, bound = np.random.default_rng(5), Bound()
    nodes = known(rng, velocities(rng) if is_measured else None)
    span = Span(horizons, np.linspace(0.2, 1, len(horizons)), capped)
    found, expected = (find(nodes, bound, factor, span) for find in (reaches, reaches_plainly))
    assert np.array_equal(found, expected, equal_nan=True)
    assert np.isnan(found).any()
    assert len(np.unique(found[-1])) > 5


def test_who_has_turned_may_get_as_far_as_it_can_reach() -> None:
    expected, zeros = Expected(np.full(2, 0.001), np.zeros(2)), np.zeros(2)
    nodes = Known(NOW, HORIZON_S, expected, zeros, zeros, np.array([-np.inf, NOW - 0.1]), zeros, None)
    bound = Bound()
    ((calm, turned),) = reaches(nodes, bound, 1.0, Span(np.array([HORIZON_S]), np.ones(1), capped=True))
    assert calm < 0.01
    assert turned == bound.reachable(HORIZON_S)
