"""Grids: the default one, runs, packed bits, growth by balls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twin_node.forecast import ForecastError, default_grid
from twin_node.forecast.grid import PER_VOXEL, decode_runs, encode_runs, grow_by, pack, reach_of, spread, unpack
from twin_node.scene import Bool, Grid


def test_default_grid_covers_the_workspace() -> None:
    grid = default_grid(np.array([[-1.0, -0.5, 0.0], [1.0, 0.51, 0.8]]))
    assert grid.voxel_size == 0.02
    assert grid.dims == (100, 51, 40)
    assert grid.indices(np.array([[0.999, 0.509, 0.799]]))[0] >= 0


def test_default_grid_is_coarsened_to_the_cap() -> None:
    grid = default_grid(np.array([[0.0, 0.0, 0.0], [10.0, 7.0, 3.0]]), most_voxels=50_000)
    assert 30_000 < grid.size <= 50_000
    assert np.all(np.array(grid.dims) * grid.voxel_size >= [10.0 - 1e-6, 7.0 - 1e-6, 3.0 - 1e-6])


@pytest.mark.parametrize(
    "corners", [[[0, 0, 0], [1, 0, 1]], [[0, 0, 0], [1, 1, np.inf]], [[0, 0, 0], [1, 1, np.nan]], [[0, 0], [1, 1]]]
)
def test_unusable_workspace_is_refused(corners: list[list[float]]) -> None:
    with pytest.raises(ForecastError, match="workspace: expected"):
        default_grid(np.array(corners, dtype=np.float64))


def test_unusable_voxel_size_is_refused() -> None:
    with pytest.raises(ForecastError, match="voxel_size"):
        default_grid(np.array([[0.0, 0, 0], [1, 1, 1]]), voxel_size=0.0)


@given(arrays(np.bool_, st.integers(1, 200)))
def test_runs_come_back(mask: Bool) -> None:
    runs = encode_runs(mask)
    assert np.array_equal(decode_runs(runs, len(mask)), mask)
    assert np.all(runs[1:, 0] > runs[:-1].sum(axis=1))


@given(arrays(np.bool_, st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 140))))
def test_packed_bits_come_back(dense: Bool) -> None:
    assert np.array_equal(unpack(pack(dense), dense.shape[2]), dense)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 14 * PER_VOXEL), st.integers(0, 2**32 - 1))
def test_growth_is_the_ball(reach: int, seed: int) -> None:
    place = np.random.default_rng(seed).integers(0, 64, 3) + 15
    levels = np.zeros((94, 94, 94), np.uint8)
    levels[tuple(place)] = reach + 1
    grown = grow_by(levels, np.array([reach + 1]))
    distances = np.linalg.norm(np.indices(levels.shape) - place[:, None, None, None], axis=0)
    assert np.array_equal(grown, distances <= reach / PER_VOXEL)


def test_reach_is_never_less_than_the_radius_and_half_a_diagonal_and_little_more() -> None:
    grid = Grid(np.zeros(3), 0.02, (5, 5, 5))
    radii = np.linspace(1e-4, 1.0, 500)
    reach = reach_of(grid, radii) / PER_VOXEL
    assert np.all(reach >= radii / 0.02 + np.sqrt(0.75) - 1e-6)
    assert np.all(reach <= 1.17 * (radii / 0.02 + np.sqrt(0.75)) + 0.25)
    assert reach_of(grid, np.zeros(1))[0] == 0


def test_growth_of_many_levels_is_the_union() -> None:
    rng = np.random.default_rng(3)
    levels = np.zeros((40, 40, 70), np.uint8)
    places = rng.integers(8, 32, (20, 3))
    levels[tuple(places.T)] = rng.integers(1, 8, 20)
    expected = np.zeros(levels.shape, np.bool_)
    for place in np.argwhere(levels):
        single = np.zeros(levels.shape, np.uint8)
        single[tuple(place)] = levels[tuple(place)]
        expected |= grow_by(single, np.array([levels[tuple(place)]]))
    assert np.array_equal(grow_by(levels, np.unique(levels[levels > 0])), expected)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.8))
def test_spread_holds_every_ball_inside_the_grid(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    grid = Grid(np.array([1.0, -2.0, 0.5]), 0.05, (20, 17, 70))
    places = rng.integers(-5, 75, (3, 5)).astype(np.int32)
    radii = rng.uniform(0, radius, 5)
    reached = spread(grid, places, reach_of(grid, radii), np.ones(places.shape[1], np.bool_))
    centers = grid.centers(np.arange(grid.size))
    for place, reach in zip(grid.origin + (places.T + 0.5) * grid.voxel_size, radii, strict=True):
        inside = np.flatnonzero(np.linalg.norm(centers - place, axis=1) <= reach + 1e-9)
        assert np.isin(inside, reached.indices).all()
    assert np.all(np.diff(reached.indices) > 0)
    held = grid.indices(grid.origin + (places.T + 0.5) * grid.voxel_size)
    assert np.array_equal(np.unique(held[held >= 0]), reached.indices[reached.core])


def test_spread_of_nothing_and_of_places_far_outside() -> None:
    grid = Grid(np.zeros(3), 0.1, (5, 5, 5))
    assert len(spread(grid, np.zeros((3, 0), np.int32), np.zeros(0, np.uint8), np.zeros(0, np.bool_)).indices) == 0
    assert len(spread(grid, np.full((3, 3), 90, np.int32), np.full(3, 2, np.uint8), np.ones(3, np.bool_)).indices) == 0
