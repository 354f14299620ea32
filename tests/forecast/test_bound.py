"""The bound reaches its target, grows after surprises and shrinks again."""

from __future__ import annotations

import numpy as np

from twin_node.forecast.bound import Bound, BoundParameters

HORIZONS = np.array([0.033, 0.083, 0.133, 0.183, 0.233])


def radii(bound: Bound, errors: list[float], age: float = 1.0) -> np.ndarray:
    count = len(errors)
    return bound.radii(np.array(errors), np.zeros(count), np.full(count, age), HORIZONS)


def test_radius_grows_with_horizon_error_and_speed() -> None:
    bound = Bound()
    found = radii(bound, [0.02, 0.08])
    assert np.all(np.diff(found, axis=0) > 0)
    assert np.all(found[:, 1] > found[:, 0])
    fast = bound.radii(np.array([0.02]), np.array([1.0]), np.ones(1), HORIZONS)
    assert np.all(fast[:, 0] > found[:, 0])


def test_without_a_record_the_reachable_set_stands_in() -> None:
    bound = Bound(BoundParameters(acceleration=8.0))
    young = radii(bound, [0.0], age=0.1)
    assert np.all(young[:, 0] >= 0.5 * 8.0 * HORIZONS**2 - 1e-12)
    assert young[-1, 0] > radii(bound, [0.0], age=1.0)[-1, 0]


def test_no_radius_exceeds_what_a_person_covers() -> None:
    assert np.all(radii(Bound(), [5.0])[:, 0] <= 1.6 * HORIZONS + 1e-12)


def test_coverage_settles_at_the_target() -> None:
    """Errors drawn from one distribution: the factor finds its 99 % quantile."""
    rng = np.random.default_rng(0)
    bound = Bound(BoundParameters(coverage=0.95, least_factor=0.01))
    inside = []
    for step in range(4000):
        radius = radii(bound, [0.05])[-1, 0]
        covered = float(np.mean(np.abs(rng.normal(0, 0.04, 50)) < radius))
        bound.observe(covered, 0.2)
        if step > 1000:
            inside.append(covered)
    assert 0.94 < np.mean(inside) < 0.985


def test_a_surprise_widens_at_once_and_is_forgotten_slowly() -> None:
    bound = Bound()
    calm = bound.factor
    for _ in range(5):
        bound.observe(0.8, 0.2)
    surprised = bound.factor
    assert surprised > 1.5 * calm
    bound.observe(1.0, 0.2)
    assert bound.factor > 0.9 * surprised
    for _ in range(60):
        bound.observe(1.0, 0.2)
    assert bound.factor < 1.1 * calm


def test_coverage_is_not_a_number_before_the_first_truth() -> None:
    bound = Bound()
    assert np.isnan(bound.coverage)
    bound.observe(0.9, 1.0)
    bound.observe(1.0, 1.0)
    assert np.isclose(bound.coverage, 0.95)
