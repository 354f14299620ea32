"""Growth of parts by balls: the compiled kernel against the plain one, and both against the definition."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from twin_node.forecast import growth
from twin_node.forecast.growth import (
    PER_VOXEL,
    Points,
    Spread,
    grown,
    reach_of,
    shifts_of,
    spread,
    spread_reference,
)
from twin_node.forecast.kernels import kernels
from twin_node.native_build import KernelSources
from twin_node.scene import Grid

compiled = pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")


def points_of(places: NDArray[np.integer], labels: NDArray[np.integer] | None = None) -> Points:
    count = places.shape[1]
    labels = np.zeros(count, np.int64) if labels is None else labels.astype(np.int64)
    return Points(places.astype(np.int32), labels, np.arange(count) % 2 == 0)


def still(grid: Grid, places: NDArray[np.integer], reach: int) -> Spread:
    """One part that stands and grows by `reach`."""
    (only,) = spread(grid, points_of(places), np.zeros((1, 1, 3), np.int32), np.array([[reach]], np.uint16))
    return only


def random_case(seed: int, largest: int) -> tuple[Grid, Points, NDArray[np.int32], NDArray[np.uint16]]:
    """A grid of odd size, parts inside and beside it, and three layers of shifts and reaches."""
    rng = np.random.default_rng(seed)
    dims = tuple(int(n) for n in rng.integers(1, [40, 30, 150]))
    parts = int(rng.integers(1, 6))
    count = int(rng.integers(0, 120))
    places = (rng.normal(0.5, 0.5, (3, count)) * np.array(dims)[:, None]).round()
    shifts = rng.normal(0, 6, (3, parts, 3)).round().astype(np.int32)
    reach = rng.integers(0, largest, (3, parts)).astype(np.uint16)
    return Grid(np.zeros(3), 0.02, dims), points_of(places, rng.integers(0, parts, count)), shifts, reach


@compiled
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 9, 40]))
@example(1, 256)
@example(2, 256)
@example(3, 256)
@example(4, 256)
@example(5, 256)
@example(6, 256)
@example(7, 600)
@example(8, 600)
def test_compiled_growth_is_the_plain_one_bit_by_bit(seed: int, largest: int) -> None:
    case = random_case(seed, largest)
    for found, expected in zip(spread(*case), spread_reference(*case), strict=True):
        assert np.array_equal(found.indices, expected.indices)
        assert np.array_equal(found.core, expected.core)
        assert found.indices.dtype == expected.indices.dtype == np.uint32


@settings(max_examples=30)
@given(st.integers(0, 14 * PER_VOXEL), st.integers(0, 2**32 - 1))
def test_growth_is_the_ball(reach: int, seed: int) -> None:
    grid = Grid(np.zeros(3), 0.02, (50, 45, 70))
    place = np.random.default_rng(seed).integers(0, 45, 3)
    distances = np.linalg.norm(np.indices(grid.dims) - place[:, None, None, None], axis=0)
    expected = np.flatnonzero(distances <= reach / PER_VOXEL)
    assert np.array_equal(still(grid, place[:, None], reach).indices, expected)


@pytest.mark.parametrize("voxel_size", [0.02, 0.005, 0.002])
def test_reach_is_never_less_than_the_radius_and_half_a_diagonal_and_little_more(voxel_size: float) -> None:
    grid = Grid(np.zeros(3), voxel_size, (5, 5, 5))
    radii = np.linspace(1e-4, 1.0, 500)
    reach = reach_of(grid, radii) / PER_VOXEL
    assert np.all(reach >= radii / voxel_size + np.sqrt(0.75) - 1e-6)
    assert np.all(reach <= 1.17 * (radii / voxel_size + np.sqrt(0.75)) + 0.25)
    assert reach_of(grid, np.zeros(1))[0] == 0


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.8))
def test_spread_holds_every_ball_inside_the_grid(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    grid = Grid(np.array([1.0, -2.0, 0.5]), 0.05, (20, 17, 70))
    places, radii = rng.integers(-5, 75, (3, 5)), rng.uniform(0, radius, 5)
    parts = Points(places.astype(np.int32), np.arange(5), np.ones(5, np.bool_))
    (reached,) = spread(grid, parts, np.zeros((1, 5, 3), np.int32), reach_of(grid, radii[None]))
    centers = grid.centers(np.arange(grid.size))
    for place, reach in zip(grid.origin + (places.T + 0.5) * grid.voxel_size, radii, strict=True):
        inside = np.flatnonzero(np.linalg.norm(centers - place, axis=1) <= reach + 1e-9)
        assert np.isin(inside, reached.indices).all()
    assert np.all(np.diff(reached.indices.astype(np.int64)) > 0)
    held = grid.indices(grid.origin + (places.T + 0.5) * grid.voxel_size)
    assert np.array_equal(np.unique(held[held >= 0]), reached.indices[reached.core])


def test_nothing_and_places_far_outside_reach_nothing() -> None:
    grid = Grid(np.zeros(3), 0.1, (5, 5, 5))
    assert len(still(grid, np.zeros((3, 0), np.int32), 0).indices) == 0
    assert len(still(grid, np.full((3, 3), 90), 2).indices) == 0
    far = shifts_of(grid, np.array([[[1e30, 0, 0]]]))
    (reached,) = spread(grid, points_of(np.ones((3, 1))), far, np.array([[8]], np.uint8))
    assert len(reached.indices) == 0


def test_a_mask_grows_by_its_balls() -> None:
    grid = Grid(np.zeros(3), 0.1, (9, 9, 9))
    mask = np.zeros(grid.size, np.bool_)
    mask[grid.indices(np.array([[0.45, 0.45, 0.45]]))] = True
    assert grown(grid, mask, 1.5).sum() == 19  # the middle, 6 faces, 12 edges


def test_without_a_compiler_the_plain_version_takes_over_with_one_warning(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    case = random_case(3, 20)
    expected = spread(*case)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setattr(KernelSources, "shipped_library", lambda _, variant: tmp_path / variant)
    growth.kernels.cache_clear()
    try:
        with pytest.warns(UserWarning, match="plain NumPy.*no C\\+\\+ compiler found"):
            found = spread(*case)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            spread(*case)
    finally:
        growth.kernels.cache_clear()
    assert all(np.array_equal(one.indices, other.indices) for one, other in zip(found, expected, strict=True))
