"""Masks of one bit per voxel: the same as masks of bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from twin_node.forecast.bits import Bits
from twin_node.forecast.grid import encode_runs
from twin_node.forecast.kernels import kernels
from twin_node.scene import Bool

DIMS = st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 140))


def masks(dims: tuple[int, int, int], seed: int) -> tuple[Bool, Bool]:
    """Two masks in stretches, also across columns and words."""
    rng, size = np.random.default_rng(seed), int(np.prod(dims))
    one, other = (np.repeat(rng.uniform(size=size) < 0.5, rng.integers(1, 99, size))[:size] for _ in range(2))
    return one, other


@settings(max_examples=100)
@given(DIMS, st.integers(0, 2**32 - 1))
def test_bits_are_the_mask(dims: tuple[int, int, int], seed: int) -> None:
    one, other = masks(dims, seed)
    bits, others = Bits.of_mask(dims, one), Bits.of_mask(dims, other)
    assert np.array_equal(bits.mask(), one)
    assert np.array_equal(Bits.of_indices(dims, np.flatnonzero(one)).words, bits.words)
    assert np.array_equal(bits.indices(), np.flatnonzero(one))
    assert bits.count == np.count_nonzero(one)
    assert np.array_equal((bits & others).mask(), one & other)
    assert np.array_equal((bits | others).mask(), one | other)
    assert np.array_equal(bits.without(others).mask(), one & ~other)
    assert np.array_equal(bits.holds(np.arange(len(one))), one)
    assert not Bits.none(dims).mask().any() and Bits.all(dims).mask().all()


@settings(max_examples=100)
@given(DIMS, st.integers(0, 2**32 - 1))
def test_voxels_are_added_and_removed(dims: tuple[int, int, int], seed: int) -> None:
    one, other = masks(dims, seed)
    bits = Bits.of_mask(dims, one)
    bits.add(np.flatnonzero(other))
    assert np.array_equal(bits.mask(), one | other)
    bits.remove(np.flatnonzero(one))
    assert np.array_equal(bits.mask(), other & ~one)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@settings(max_examples=100)
@given(DIMS, st.integers(0, 2**32 - 1))
def test_compiled_lists_and_runs_are_the_plain_ones(dims: tuple[int, int, int], seed: int) -> None:
    one, other = masks(dims, seed)
    bits, marks = Bits.of_mask(dims, one), Bits.of_mask(dims, other)
    found, plain = bits.listed(marks), bits.listed_reference(marks)
    assert np.array_equal(found.indices, plain.indices) and np.array_equal(found.marked, plain.marked)
    assert np.array_equal(bits.runs(), encode_runs(one))
    indices = np.random.default_rng(seed).permutation(np.concatenate([plain.indices, plain.indices[:5]]))
    assert np.array_equal(Bits.of_indices(dims, indices).words, bits.words)
    assert np.array_equal(Bits.of_indices_reference(dims, indices).words, bits.words)


@pytest.mark.skipif(kernels() is None, reason="NumPy counts negative ones from the end")
@pytest.mark.parametrize("beside", [-1, 24])
def test_voxels_beside_the_grid_are_refused(beside: int) -> None:
    with pytest.raises(IndexError):
        Bits.of_indices((2, 3, 4), np.array([0, beside]))


@pytest.mark.parametrize("dims", [(4, 3, 1), (5, 4, 64), (3, 6, 70), (4, 4, 130)])
def test_grown_bits_are_all_that_touch_them(dims: tuple[int, int, int]) -> None:
    mask = np.random.default_rng(dims[2]).random(dims) < 0.03
    grown = Bits.of_mask(dims, mask.ravel()).grown()
    assert np.array_equal(grown.mask().reshape(dims), binary_dilation(mask, np.ones((3, 3, 3))))
    assert grown.count == grown.mask().sum(), "no bit beyond the grid"
