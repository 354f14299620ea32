"""What accelerates is held as far as its acceleration leads."""

from __future__ import annotations

import numpy as np
import pytest
from forecast_worlds import GRID, ball_voxels, state_of
from hypothesis import given
from hypothesis import strategies as st

from twin_node.forecast import Forecaster
from twin_node.forecast.growth import Points, reach_of, shifts_of, spread
from twin_node.forecast.measured import Measured
from twin_node.forecast.parts import PART_SIZE
from twin_node.forecast.prediction import Prediction, Predictor
from twin_node.forecast.swerving import Swerves, beside, swerves_of
from twin_node.forecast.tracks import Tracks
from twin_node.forecast.turning import Ways
from twin_node.scene import HORIZONS_NS, Occupancy

HORIZONS = np.array([0.1, 0.2])
PERIOD_NS = 33_333_333
LATENCY_NS = 33_000_000
SPEED, BRAKING = 1.2, 9.0
"""m/s; m/s^2."""
STRAIGHT_S = 0.3
"""Time before it brakes."""


def test_what_stays_in_its_bound_is_not_held_aside_and_what_leaves_it_is() -> None:
    aside = np.zeros((2, 3, 3))
    aside[:, :, 1] = [[0.02, 0.03, np.nan], [0.09, 0.11, np.nan]]
    swerves = swerves_of(np.zeros((2, 3, 3)), np.full((2, 3), 0.1), aside, 0.4)
    assert swerves.held.tolist() == [False, True, False]
    np.testing.assert_allclose(swerves.displacements[:, :2, 1], [[0.0, 0.03], [0.0, 0.11]])


def test_who_leaves_its_bound_on_the_way_and_is_back_in_it_at_last_is_not_held_aside() -> None:
    aside = np.zeros((4, 2, 3))
    aside[:, :, 1] = [[0.0, 0.0], [0.2, 0.01], [0.2, 0.02], [0.09, 0.2]]
    radii = np.array([[0.05, 0.3], [0.06, 0.3], [0.08, 0.3], [0.1, 0.1]])
    assert swerves_of(np.zeros((4, 2, 3)), radii, aside, 0.4).held.tolist() == [False, True]


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.floats(0.01, 1.5))
def test_between_where_it_is_led_and_where_it_swerves_a_part_is_held_in_steps_of_its_size(
    seed: int, nodes: int, farthest: float
) -> None:
    """At every horizon, each part on its own way: beyond its size a gap would open that nothing holds."""
    rng = np.random.default_rng(seed)
    places = np.tile(4 * np.arange(nodes, dtype=np.int32), (3, 1))
    points = Points(places, np.arange(nodes), np.ones(nodes, np.bool_))
    growing = np.linspace(0, 1, 4)[:, None, None]
    led, aside = (growing * rng.uniform(-1, 1, (nodes, 3)) * farthest / np.sqrt(3) for _ in range(2))
    swerving = rng.uniform(size=nodes) < 0.6
    radii = rng.uniform(0.02, 0.2, (4, nodes))
    ways = beside(Ways(points, led, radii), points, Swerves(led + aside, swerving))
    assert ways.radii.shape == ways.displacements.shape[:2]
    for node in range(nodes):
        mine = ways.points.labels[(ways.points.places == places[:, [node]]).all(axis=0)]
        way, size = ways.displacements[:, mine], np.linalg.norm(aside[-1, node])
        np.testing.assert_array_equal(way[:, 0], led[:, node])
        np.testing.assert_allclose(way[:, -1], (led + swerving[node] * aside)[:, node], atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(np.diff(way[-1], axis=0), axis=-1).sum(), swerving[node] * size)
        assert np.linalg.norm(np.diff(way, axis=1), axis=-1).max(initial=0) <= PART_SIZE + 1e-9
        assert (ways.radii[:, mine] <= radii[:, [node]]).all()


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.floats(0, 1))
def test_swerves_are_held_from_one_end_to_the_other(seed: int, nodes: int, share: float) -> None:
    """Of several nodes, each with a rim, some of which do not swerve."""
    rng = np.random.default_rng(seed)
    block = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij")).reshape(3, -1)
    corners = rng.integers(8, 26, (nodes, 3))
    places = np.concatenate([corner[:, None] + block for corner in corners], axis=1).astype(np.int32)
    labels = np.repeat(np.arange(nodes), block.shape[1])
    points = Points(places, labels, np.ones(len(labels), np.bool_))
    led, aside = rng.uniform(-0.2, 0.2, (1, nodes, 3)), rng.uniform(-0.3, 0.3, (1, nodes, 3))
    swerving = rng.uniform(size=nodes) < 0.6
    ways = beside(Ways(points, led, np.full((1, nodes), 0.04)), points, Swerves(led + aside, swerving))
    held = spread(GRID, ways.points, shifts_of(GRID, ways.displacements), reach_of(GRID, ways.radii))[0].indices
    middles = GRID.origin + (corners + 2.0) * GRID.voxel_size + led[0] + share * aside[0] * swerving[:, None]
    found = GRID.indices(middles)
    assert np.isin(found[found >= 0], held).all()


def test_neither_rims_nor_what_goes_on_straight_are_held_where_something_swerves_to() -> None:
    places = np.array([[20, 20, 10], [20, 20, 10], [10, 20, 24]], np.int32)  # a core and its rim, and another's core
    points = Points(places, np.array([0, 0, 1]), np.array([True, False, True]))
    far = np.zeros((1, 2, 3))
    far[0, :, 1] = 0.4
    ways = beside(Ways(points, 0 * far, np.full((1, 2), 0.04)), points, Swerves(far, np.array([True, False])))
    held = spread(GRID, ways.points, shifts_of(GRID, ways.displacements), reach_of(GRID, ways.radii))[0].indices
    _, y, z = GRID.centers(held.astype(np.int64)).T
    assert (y > 0.3).any()
    assert (z[y > 0.3] < 0.4).all(), "the core's height"


def test_what_stays_in_its_bound_does_not_swerve_and_nothing_swerves_without_end() -> None:
    mixed, radii = np.zeros((2, 4, 3)), np.full((2, 4), 0.1)
    accelerated = np.zeros((2, 4, 3))
    accelerated[:, :, 0] = [[0.02, 0.1, 1.0, np.nan], [0.08, 0.4, 4.0, np.nan]]
    found = swerves_of(mixed, radii, accelerated, largest=0.8)
    assert found.held.tolist() == [False, True, True, False]
    assert np.allclose(found.displacements[:, :, 0], [[0, 0.1, 0.2, 0], [0, 0.4, 0.8, 0]])


def braked(samples: int, turns: bool = True, begins: int = 0, measured: Measured | None = None) -> Prediction:
    """What is forecast of a node that came at a steady speed and brakes, at 60 Hz; its path begins anew at a sample."""
    tracks, predictor = Tracks(), Predictor(turns=turns)
    for sample in range(samples):
        time, braking = sample / 60, max(sample - 30, 0) / 60
        place = np.array([[SPEED * time - BRAKING * braking**2 / 2, 0, 0.5]])
        velocity = np.array([[SPEED - BRAKING * braking, 0, 0]])
        if 0 < sample == begins:
            place = place + 5.0
        place = place + 5.0 * (0 < begins < sample)
        association = tracks.follow(time, place, velocity)
        predictor.advance(tracks.history, association, float(HORIZONS[-1]), measured)
    return predictor.predict(HORIZONS, factor=0.2)


def test_what_brakes_may_come_back() -> None:
    braking_s = 3 / 60
    came_true = (SPEED - BRAKING * braking_s) * HORIZONS[-1] - BRAKING * HORIZONS[-1] ** 2 / 2
    found = braked(34)
    led, swerved = (places[-1, 0, 0] for places in (found.displacements, found.swerves.displacements))
    assert found.swerves.held[0]
    assert came_true < swerved < led - found.radii[-1, 0]


def test_what_goes_on_or_is_not_asked_about_or_has_just_come_does_not_swerve() -> None:
    assert not braked(30).swerves.held[0]
    assert not braked(34, turns=False).swerves.held[0]
    assert not braked(34, begins=30).swerves.held[0]


@pytest.mark.parametrize("alone", [False, True])
def test_what_has_a_measured_velocity_does_not_swerve(alone: bool) -> None:
    """A limb stays in the bound of people; what moves by itself has a narrower one."""
    neither = np.zeros(1, np.bool_)
    sure = Measured(np.full(1, 0.05), neither, np.full(1, alone), neither, np.full(1, -np.inf), np.zeros(1))
    assert not braked(34, measured=sure).swerves.held[0]


def place(stamp: int) -> np.ndarray:
    """Straight on across the grid, then braking, and back."""
    time, braking = stamp * 1e-9, max(stamp * 1e-9 - STRAIGHT_S, 0.0)
    return np.array([SPEED * time - BRAKING * braking**2 / 2 - 0.3, 0.0, 0.45])


def share_held(occupancy: Occupancy) -> float:
    ball = ball_voxels(place(occupancy.publish_stamp + HORIZONS_NS[-1]))
    return float(np.isin(ball, occupancy.layers[-1].indices).mean())


def test_a_first_turn_is_foreseen_once_it_brakes() -> None:
    forecaster, held = Forecaster(GRID), []
    for number in range(15):
        stamp = number * PERIOD_NS
        occupancy = forecaster.update(state_of(stamp, place(stamp), with_depth=False), stamp + LATENCY_NS).occupancy
        if stamp * 1e-9 > STRAIGHT_S + 0.12:
            held.append(share_held(occupancy))
    assert min(held) > 0.9
