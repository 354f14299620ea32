"""Semi-global matching: neighbours are made to agree, alike in every direction, compiled as in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.model.kernels import kernels
from twin_node.model.semi_global import JUMP_COST, smoothed, smoothed_reference
from twin_node.native_library import kernel_threads


@given(st.integers(0, 1000), st.booleans(), st.booleans())
@settings(max_examples=15)
def test_smoothing_does_not_care_which_way_round(seed: int, across: bool, down: bool) -> None:
    rng = np.random.default_rng(seed)
    costs, image = rng.random((7, 9, 5), np.float32), rng.random((7, 9, 3), np.float32)
    turn = (slice(None, None, -1 if down else 1), slice(None, None, -1 if across else 1))
    assert np.allclose(smoothed(costs[turn], image[turn]), smoothed(costs, image)[turn], atol=1e-4)


def test_neighbours_outvote_a_pixel_unless_colours_end_there() -> None:
    costs = np.zeros((9, 9, 6), np.float32)
    costs[..., 1] = -1.0
    costs[4, 4, 1] = 0
    costs[4, 4, 5] = -0.8 * JUMP_COST
    even = np.full((9, 9, 3), 0.5, np.float32)
    assert smoothed(costs, even).argmin(-1)[4, 4] == 1
    edged = even.copy()
    edged[4, 4] = 1.0
    assert smoothed(costs, edged).argmin(-1)[4, 4] == 5


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("shape", [(12, 17, 33), (7, 3, 5), (1, 6, 4), (6, 1, 1)])
def test_compiled_sums_are_those_in_numpy(shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(2)
    costs, image = rng.normal(size=shape).astype(np.float32), rng.random((*shape[:2], 3), np.float32)
    image[: shape[0] // 2] = 0.5
    for threads in (1, 2, 4):
        with kernel_threads(threads):
            np.testing.assert_array_equal(smoothed(costs, image), smoothed_reference(costs, image))
