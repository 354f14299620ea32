"""The rim about the workspace: the same lattice, larger, and what comes in is followed before it does."""

from __future__ import annotations

import numpy as np
from forecast_worlds import GRID, ball_voxels, state_of
from hypothesis import example, given, settings
from hypothesis import strategies as st

from twin_node.forecast import Forecaster
from twin_node.forecast.bits import Bits
from twin_node.forecast.margin import Margin
from twin_node.scene import HORIZONS_NS, Grid

PERIOD_NS = 33_333_333


@settings(max_examples=30, deadline=None)
@given(
    dims=st.tuples(st.integers(1, 12), st.integers(1, 12), st.integers(1, 12)),
    width=st.floats(0.0, 0.5),
    seed=st.integers(0, 2**32 - 1),
)
@example(dims=(12, 12, 12), width=0.5, seed=0)  # the larger grid would have 22,528 voxels
def test_voxels_keep_their_places(dims: tuple[int, int, int], width: float, seed: int) -> None:
    margin = Margin(Grid(np.array([0.5, -1.0, 0.0]), 0.05, dims), width, most_voxels=20_000)
    indices = np.random.default_rng(seed).integers(0, margin.inner.size, 20)
    indices = np.unique(indices)
    mask = np.zeros(margin.inner.size, np.bool_)
    mask[indices] = True
    outer = margin.outward(indices)
    assert np.all(np.diff(outer) > 0)
    padded = np.ones(margin.outer.size, np.bool_)  # the rim is full, to be cut off
    padded[margin.outward(np.arange(margin.inner.size))] = mask
    assert np.allclose(margin.outer.centers(outer), margin.inner.centers(indices))
    cropped = margin.cropped(Bits.of_mask(margin.outer.dims, padded))
    assert np.array_equal(cropped.words, Bits.of_mask(dims, mask).words)
    places = np.stack(np.unravel_index(outer, margin.outer.dims)).astype(np.int32)
    assert np.array_equal(margin.places(places), np.stack(np.unravel_index(indices, dims)))
    assert margin.outer.size <= max(20_000, margin.inner.size)


def test_what_comes_in_is_foreseen_where_it_will_be() -> None:
    """A ball enters through the side: most of it is outside when the forecast for its full entry is made."""
    forecaster = Forecaster(GRID)

    def place(stamp: int) -> np.ndarray:
        return np.array([-0.95 + 1.0 * stamp * 1e-9, 0.0, 0.45])

    for tick in range(10):
        stamp = tick * PERIOD_NS
        occupancy = forecaster.update(state_of(stamp, place(stamp)), stamp + 33_000_000).occupancy
    then = ball_voxels(place(occupancy.publish_stamp + HORIZONS_NS[-1]), 0.1)
    now = ball_voxels(place(9 * PERIOD_NS), 0.12)
    assert len(now) < 0.4 * len(then)
    assert np.isin(then, occupancy.layers[-1].indices).mean() > 0.97
