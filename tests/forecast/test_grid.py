"""Grids: the default one, and runs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twin_node.forecast import ForecastError, default_grid
from twin_node.forecast.grid import MOST_VOXELS, decode_runs, encode_runs
from twin_node.scene import Bool


def test_default_grid_covers_the_workspace() -> None:
    grid = default_grid(np.array([[-1.0, -0.5, 0.0], [1.0, 0.51, 0.8]]))
    assert grid.voxel_size == 0.02
    assert grid.dims == (100, 51, 40)
    assert grid.indices(np.array([[0.999, 0.509, 0.799]]))[0] >= 0


def test_default_grid_is_coarsened_to_the_cap() -> None:
    grid = default_grid(np.array([[0.0, 0.0, 0.0], [10.0, 7.0, 3.0]]))
    assert 0.6 * MOST_VOXELS < grid.size <= MOST_VOXELS
    assert np.all(np.array(grid.dims) * grid.voxel_size >= [10.0 - 1e-6, 7.0 - 1e-6, 3.0 - 1e-6])


@pytest.mark.parametrize(
    "corners", [[[0, 0, 0], [1, 0, 1]], [[0, 0, 0], [1, 1, np.inf]], [[0, 0, 0], [1, 1, np.nan]], [[0, 0], [1, 1]]]
)
def test_unusable_workspace_is_refused(corners: list[list[float]]) -> None:
    with pytest.raises(ForecastError, match="workspace: expected"):
        default_grid(np.array(corners, dtype=np.float64))


@pytest.mark.parametrize("voxel_size", [0.0, -1.0, np.inf, np.nan, 20.0])
def test_unusable_voxel_size_is_refused(voxel_size: float) -> None:
    with pytest.raises(ForecastError, match="voxel_size: expected"):
        default_grid(np.array([[0.0, 0, 0], [1, 1, 1]]), voxel_size=voxel_size)


@given(arrays(np.bool_, st.integers(1, 200)))
def test_runs_come_back(mask: Bool) -> None:
    runs = encode_runs(mask)
    assert np.array_equal(decode_runs(runs, len(mask)), mask)
    assert np.all(runs[1:, 0] > runs[:-1].sum(axis=1))


def test_runs_may_touch() -> None:
    assert decode_runs(np.array([[1, 2], [3, 1]], np.uint32), 5).tolist() == [False, True, True, True, False]


@pytest.mark.parametrize("runs", [[[3, 1], [1, 1]], [[1, 3], [2, 1]], [[4, 2]]])
def test_runs_that_overlap_or_reach_too_far_are_refused(runs: list[list[int]]) -> None:
    with pytest.raises(ForecastError, match="disjoint"):
        decode_runs(np.array(runs, np.uint32), 5)


def test_a_workspace_in_millimetres_is_refused() -> None:
    with pytest.raises(ForecastError, match=r"workspace: expected one in metres .* found 1200 x 1200 x 900 m; .*1000"):
        default_grid(np.array([[-600.0, -600, 0], [600, 600, 900]]))
