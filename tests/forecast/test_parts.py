"""Parts of what moves: compiled, the same as by NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.kernels import kernels
from twin_node.forecast.parts import split, split_reference
from twin_node.scene import Grid

pytestmark = pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    dims=st.tuples(st.integers(1, 20), st.integers(1, 20), st.integers(1, 20)),
    voxel_size=st.sampled_from([0.02, 0.03, 0.2]),
    share=st.sampled_from([0.0, 0.02, 0.5]),
)
def test_compiled_parts_are_the_plain_ones(
    seed: int, dims: tuple[int, int, int], voxel_size: float, share: float
) -> None:
    rng, grid = np.random.default_rng(seed), Grid(np.array([0.1, -0.2, 0.3]), voxel_size, dims)
    indices = np.flatnonzero(rng.uniform(size=grid.size) < share)
    likely = rng.uniform(size=len(indices)) < 0.5
    found, plain = split(grid, indices, likely), split_reference(grid, indices, likely)
    for name in ("indices", "places", "labels", "likely", "centers"):
        one, other = getattr(found, name), getattr(plain, name)
        assert one.dtype == other.dtype and np.array_equal(one, other), name
