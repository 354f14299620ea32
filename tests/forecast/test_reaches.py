"""How far nodes may be from where they are led: compiled, the same to the bit as by NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_node.forecast.bound import Bound, Expected
from twin_node.forecast.kernels import kernels
from twin_node.forecast.measured import UNKNOWN_SPEED, Measured, start_radii
from twin_node.forecast.reaches import Known, Span, reaches, reaches_reference, staleness

COUNT, NOW, HORIZON_S = 400, 3.0, 0.2
HORIZONS = np.array([0.033, 0.083, 0.133, 0.183, 0.233])


def velocities(rng: np.random.Generator) -> Measured:
    flying, alone, falling = rng.random((3, COUNT)) < 0.2
    sigmas = np.minimum(rng.uniform(0, 1.3 * UNKNOWN_SPEED, COUNT), UNKNOWN_SPEED)
    clear_s = np.where(falling, rng.uniform(0, 0.4, COUNT), 0)
    return Measured(sigmas, flying, alone, falling, np.full(COUNT, -np.inf), clear_s)


def known(rng: np.random.Generator, measured: Measured | None) -> Known:
    """Nodes of all kinds and ages; nothing is known of the errors of one."""
    scales = rng.uniform(0, 0.5, COUNT)
    scales[7] = np.nan
    expected = Expected(scales, rng.uniform(0, 0.4, COUNT))
    began, born = NOW - rng.uniform(0, 0.4, COUNT), NOW - rng.uniform(0, 0.6, COUNT)
    turned = np.where(rng.random(COUNT) < 0.3, NOW - rng.uniform(0, 1, COUNT), -np.inf)
    return Known(NOW, HORIZON_S, expected, born, began, turned, rng.uniform(0, 4, COUNT), measured, stale_s=0.04)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("is_measured", [False, True])
@pytest.mark.parametrize("capped", [False, True])
@pytest.mark.parametrize("factor", [0.05, 1.0, 3.0])
@pytest.mark.parametrize("horizons", [HORIZONS, HORIZONS[-1:]])
def test_compiled_to_the_bit_as_reference(horizons: np.ndarray, factor: float, capped: bool, is_measured: bool) -> None:
    rng, bound = np.random.default_rng(5), Bound()
    nodes = known(rng, velocities(rng) if is_measured else None)
    span = Span(horizons, np.linspace(0.2, 1, len(horizons)), capped)
    found, expected = (find(nodes, bound, factor, span) for find in (reaches, reaches_reference))
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


def of_two(born: np.ndarray, spread: float, sigma: float, alone: np.ndarray) -> Known:
    """Two nodes of which hardly any error is expected, with measured velocities."""
    no, never, zeros = np.zeros(2, np.bool_), np.full(2, -np.inf), np.zeros(2)
    told = Measured(np.full(2, sigma), no, alone, no, never, zeros)
    return Known(NOW, HORIZON_S, Expected(np.full(2, 0.001), np.full(2, spread)), born, born, never, zeros, told)


def test_a_limb_at_rest_may_start_however_little_error_is_expected() -> None:
    nodes = of_two(np.zeros(2), spread=0.0, sigma=0.0, alone=np.array([False, True]))
    ((limb, whole),) = reaches(nodes, Bound(), 1.0, Span(np.array([HORIZON_S]), np.ones(1), capped=True))
    assert limb == start_radii(np.array([HORIZON_S]))[0]
    assert whole < 0.01


def test_who_is_new_may_get_as_far_as_its_measured_velocity_is_uncertain() -> None:
    nodes = of_two(np.array([0.0, NOW - 0.05]), spread=0.3, sigma=0.5, alone=np.ones(2, np.bool_))
    bound = Bound()
    ((tried, new),) = reaches(nodes, bound, 1.0, Span(np.array([HORIZON_S]), np.ones(1), capped=False))
    assert tried < 0.01
    assert new == bound.reachable(HORIZON_S) + 1.5 * 0.5 * HORIZON_S


def test_what_flies_is_closely_bounded_until_it_may_touch_something() -> None:
    """Of what it may meet by the last horizon its bound held a share sooner, too: 8 cm after 33 ms."""
    nodes = of_two(np.full(2, NOW - 0.1), spread=0.3, sigma=0.1, alone=np.ones(2, np.bool_))
    assert nodes.measured is not None
    yes = np.ones(2, np.bool_)
    flying = replace(nodes.measured, flying=yes, falling=yes, clear_s=np.array([0.0, 0.1]))
    span = Span(HORIZONS, HORIZONS / HORIZONS[-1], capped=True)
    radii = reaches(replace(nodes, measured=flying), Bound(), 1.0, span)
    assert (radii[:2, 1] < 0.6 * radii[:2, 0]).all()
    assert np.array_equal(radii[2:, 1], radii[2:, 0])


def test_nobody_gets_farther_than_people_do_however_wide_the_calibrated_bound_is() -> None:
    nodes = of_two(np.zeros(2), spread=0.0, sigma=0.1, alone=np.ones(2, np.bool_))
    wide, horizons = 1000.0, np.array([HORIZON_S])
    free, capped = (reaches(nodes, Bound(), wide, Span(horizons, np.ones(1), capped)) for capped in (False, True))
    assert nodes.measured is not None
    assert np.allclose(capped, nodes.measured.most(nodes.speeds, horizons))
    assert (capped < 0.5 * free).all()


def test_a_velocity_between_images_far_apart_was_so_some_time_ago() -> None:
    assert staleness(np.array([0.0])) == staleness(np.array([0.0, 0.1])) == 0.0
    assert np.isclose(staleness(np.array([0.0, 0.1, 0.3])), 0.09)
    assert np.isclose(staleness(np.array([0.0, 0.4])), 0.2)
    bound, a = Bound(), Bound().parameters.acceleration
    assert np.isclose(bound.reachable(0.2, 0.1), a * (0.3**2 - 0.1**2) / 2)


def test_who_is_new_may_have_changed_its_velocity_since_it_was_measured() -> None:
    nodes, bound = of_two(np.full(2, NOW - 0.05), spread=0.0, sigma=0.0, alone=np.ones(2, np.bool_)), Bound()
    span = Span(np.array([HORIZON_S]), np.ones(1), capped=False)
    ((new, _),) = reaches(replace(nodes, stale_s=0.1), bound, 1.0, span)
    assert np.isclose(new, bound.reachable(HORIZON_S, 0.1))
