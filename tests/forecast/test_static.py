"""Voxels of measured surfaces: the compiled ones are the plain ones, to the voxel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, HEIGHT, WIDTH, camera, floor_depth
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.kernels import kernels
from twin_node.forecast.static import mark, mark_plainly
from twin_node.scene import Float32, Grid, View

CAMERA = camera("cam", np.array([1.3, 0.7, 1.0]))


def view(depth: Float32) -> View:
    return View(CAMERA, 0, np.zeros((HEIGHT, WIDTH, 3), np.uint8), depth)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.004, 0.1))
def test_compiled_marks_are_the_plain_ones(seed: int, voxel_size: float) -> None:
    rng = np.random.default_rng(seed)
    grid = replace(GRID, voxel_size=voxel_size, dims=(17, 30, 23))
    seen = view(rng.uniform(0, 4, (HEIGHT, WIDTH)).astype(np.float32))
    where = rng.uniform(size=(HEIGHT, WIDTH)) < 0.7
    before = rng.uniform(size=grid.size) < 0.01
    one, other = before.copy(), before.copy()
    mark(grid, one, seen, where)
    mark_plainly(grid, other, seen, where)
    assert np.array_equal(one, other)


def test_the_floor_is_marked_where_it_is_asked_for() -> None:
    grid = Grid(GRID.origin - [0, 0, 0.005], GRID.voxel_size, GRID.dims)
    marked = np.zeros(grid.size, np.bool_)
    where = np.zeros((HEIGHT, WIDTH), np.bool_)
    mark(grid, marked, view(floor_depth(CAMERA)), where)
    assert not marked.any()
    mark(grid, marked, view(floor_depth(CAMERA)), ~where)
    assert set(np.unravel_index(np.flatnonzero(marked), grid.dims)[2].tolist()) == {0}
    assert marked.reshape(grid.dims)[10:30, 10:30, 0].mean() > 0.9
