"""Layers ahead: the compiled kernel against the plain composition."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.ahead import BOUND_PROBABILITY, CORE_PROBABILITY, Ahead, layers_of, layers_of_reference
from twin_node.forecast.kernels import kernels
from twin_node.forecast.parts import PART_SIZE, Parts
from twin_node.forecast.swerving import Swerves
from twin_node.scene import HORIZONS_NS, Grid, OccupancyLayer

GRID = Grid(np.array([-0.3, 0.1, 0.0]), 0.02, (31, 26, 70))
Find = Callable[[Grid, Ahead], tuple[OccupancyLayer, ...]]
compiled = pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")


def random_case(seed: int, speed: float) -> Ahead:
    """Parts inside and beside the grid, some of which turn or leave, and some that may start."""
    rng = np.random.default_rng(seed)
    count, voxels, resting = (int(n) for n in rng.integers([0, 0, 0], [9, 90, 12]))
    labels = rng.integers(0, max(count, 1), voxels if count else 0)
    places = rng.integers(-12, [[40], [35], [75]], (3, len(labels))).astype(np.int32)
    centers = GRID.origin + rng.uniform(-0.3, 1.0, (count, 3))
    parts = Parts(np.arange(len(labels)), places, labels, rng.random(len(labels)) < 0.7, centers)
    layers = len(HORIZONS_NS)
    ways = rng.normal(0, speed, (count, 3)) * np.linspace(0.2, 1, layers)[:, None, None]
    radii = np.sort(rng.choice([0.0, 0.02, 0.1, 0.4], (layers, count)), axis=0) * rng.random((layers, count))
    rest = rng.integers(-3, 30, (3, resting)).astype(np.int32)
    swerves = Swerves(ways + rng.normal(0, speed, ways.shape), rng.random(count) < 0.4)
    return Ahead(parts, ways, radii, rng.random(count) < 0.4, swerves, rest, np.linspace(0, 0.1, layers))


def _nowhere(ways: np.ndarray) -> Swerves:
    return Swerves(ways, np.zeros(ways.shape[1], np.bool_))


@compiled
@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.1, 2.0]))
def test_compiled_layers_are_the_plain_ones_bit_by_bit(seed: int, speed: float) -> None:
    case = random_case(seed, speed)
    for found, expected in zip(layers_of(GRID, case), layers_of_reference(GRID, case), strict=True):
        assert found.horizon_ns == expected.horizon_ns
        assert np.array_equal(found.indices, expected.indices)
        assert np.array_equal(found.probability, expected.probability)
        assert found.probability.dtype == expected.probability.dtype == np.uint8


@pytest.mark.parametrize("find", [layers_of, layers_of_reference])
def test_what_leaves_the_grid_is_held_along_its_way_and_what_stays_in_is_not(
    find: Callable[[Grid, Ahead], tuple[OccupancyLayer, ...]],
) -> None:
    ways = np.zeros((len(HORIZONS_NS), 2, 3))
    ways[:, :, 1] = -0.2
    centers = np.array([[-0.1, 0.0, 0.5], [0.1, 0.35, 0.5]])  # beside the grid, and in it
    places = np.floor((centers - GRID.origin) / GRID.voxel_size).T.astype(np.int32)
    parts = Parts(np.arange(2), places, np.arange(2), np.ones(2, np.bool_), centers)
    no = np.zeros((3, 0), np.int32)
    radii = np.full((len(HORIZONS_NS), 2), PART_SIZE / 2)
    case = Ahead(parts, ways, radii, np.zeros(2, np.bool_), _nowhere(ways), no, np.zeros(len(HORIZONS_NS)))
    last, back = find(GRID, case)[-1], np.array([0.0, 0.15, 0.0])
    assert np.isin(GRID.indices(centers[:1] + back), last.indices).all()
    assert not np.isin(GRID.indices(centers[1:] + back), last.indices).any()
    assert set(last.probability.tolist()) == {CORE_PROBABILITY, BOUND_PROBABILITY}


def test_rims_grow_little_and_what_rests_grows_by_its_own_radius() -> None:
    layers, no = len(HORIZONS_NS), np.zeros(1, np.bool_)
    rim, rest = np.full((3, 1), 6, np.int32), np.full((3, 1), 20, np.int32)
    parts = Parts(np.arange(1), rim, np.zeros(1, np.int64), no, np.ones((1, 3)))
    still = np.zeros((layers, 1, 3))
    case = Ahead(parts, still, np.full((layers, 1), 0.4), no, _nowhere(still), rest, np.full(layers, 0.1))
    places = np.stack(np.unravel_index(layers_of(GRID, case)[-1].indices, GRID.dims))
    about_rim, about_rest = np.linalg.norm(places - 6, axis=0), np.linalg.norm(places - 20, axis=0)
    assert (about_rim <= 4).any()
    assert ((about_rim <= 4) | (about_rest <= 8)).all()
    assert about_rest[about_rest <= 8].max() > 5


@pytest.mark.parametrize("find", [layers_of, layers_of_reference])
@pytest.mark.parametrize(("radius", "grows"), [(0.017, False), (0.018, True)])
def test_rims_keep_their_size_while_the_bound_is_within_the_rounding_to_voxels(
    find: Find, radius: float, grows: bool
) -> None:
    layers, no, nothing = len(HORIZONS_NS), np.zeros(1, np.bool_), np.zeros((3, 0), np.int32)
    places = np.array([[6, 20]] * 3, np.int32)
    parts = Parts(np.arange(2), places, np.zeros(2, np.int64), np.array([True, False]), np.ones((1, 3)))
    still = np.zeros((layers, 1, 3))
    case = Ahead(parts, still, np.full((layers, 1), radius), no, _nowhere(still), nothing, np.zeros(layers))
    found = np.stack(np.unravel_index(find(GRID, case)[0].indices, GRID.dims))
    assert np.count_nonzero(found[0] < 13) > 1, "what is likely grows"
    assert (np.count_nonzero(found[0] > 13) > 1) == grows


@pytest.mark.parametrize("find", [layers_of, layers_of_reference])
def test_what_accelerates_is_held_as_far_as_that_leads_and_its_rim_is_not(find: Find) -> None:
    layers, no = len(HORIZONS_NS), np.zeros(1, np.bool_)
    places = np.stack([np.full(3, 6), [6, 20, 6]], axis=1).astype(np.int32)
    parts = Parts(np.arange(2), places, np.zeros(2, np.int64), np.array([True, False]), np.ones((1, 3)))
    still, aside = np.zeros((layers, 1, 3)), np.zeros((layers, 1, 3))
    aside[:, :, 0] = 0.3  # 15 voxels
    swerves, rest = Swerves(aside, np.ones(1, np.bool_)), np.zeros((3, 0), np.int32)
    case = Ahead(parts, still, np.full((layers, 1), 0.08), no, swerves, rest, np.zeros(layers))
    found = find(GRID, case)[-1].indices
    way = np.ravel_multi_index((np.arange(6, 22), 6, 6), GRID.dims)
    assert np.isin(way, found).all()
    places = np.stack(np.unravel_index(found, GRID.dims))
    assert places[0][places[1] >= 16].max() < 10
    assert np.linalg.norm((places - np.array([[21], [6], [6]]))[:, places[0] >= 21], axis=0).max() < 4
