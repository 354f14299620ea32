"""Parts of what moves: how large they are and what they hold; compiled, the same as by NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.kernels import kernels
from twin_node.forecast.parts import Parts, split, split_reference
from twin_node.scene import Grid

GRID = Grid(np.array([0.1, -0.2, 0.3]), 0.02, (12, 9, 10))


def parts_of(share: float = 0.3) -> Parts:
    """Of voxels all over a grid, half of them likely."""
    rng = np.random.default_rng(7)
    indices = np.flatnonzero(rng.uniform(size=GRID.size) < share)
    return split(GRID, indices, rng.uniform(size=len(indices)) < 0.5)


@pytest.mark.parametrize(("voxel_size", "side"), [(0.01, 8), (0.02, 4), (0.03, 3), (0.08, 1), (0.2, 1)])
def test_parts_are_eight_centimetres_wide_or_as_near_to_it_as_voxels_allow(voxel_size: float, side: int) -> None:
    grid = Grid(np.zeros(3), voxel_size, (16, 4, 4))
    row = np.ravel_multi_index((np.arange(16), np.zeros(16, np.int64), np.zeros(16, np.int64)), grid.dims)
    assert split(grid, row, np.ones(16, np.bool_)).labels.tolist() == [x // side for x in range(16)]


def test_the_cell_of_a_part_holds_its_voxels_and_those_of_no_other_and_its_middle_is_theirs() -> None:
    parts = parts_of()
    first, last = parts.cells(GRID)
    within = (parts.places.T[:, None] >= first).all(axis=2) & (parts.places.T[:, None] <= last).all(axis=2)
    assert parts.count > 5
    assert np.array_equal(within, parts.labels[:, None] == np.arange(parts.count))
    assert (last - first == 3).all()
    for part, middle in enumerate(parts.centers):
        assert middle == pytest.approx(GRID.centers(parts.indices[parts.labels == part]).mean(axis=0))


def test_some_of_the_parts_are_the_parts_of_their_voxels() -> None:
    parts = parts_of()
    chosen = np.arange(parts.count) % 3 == 1
    some, again = parts.of(chosen), split(GRID, parts.indices[chosen[parts.labels]], parts.likely[chosen[parts.labels]])
    for name in ("indices", "places", "labels", "likely", "centers"):
        assert np.array_equal(getattr(some, name), getattr(again, name)), name


def test_rims_have_labels_of_their_own_where_they_are_told_apart() -> None:
    parts = parts_of()
    labels = parts.points_and_rims.labels
    assert np.array_equal(labels[parts.likely], parts.labels[parts.likely])
    assert np.array_equal(labels[~parts.likely] - parts.count, parts.labels[~parts.likely])
    assert not np.isin(labels[~parts.likely], labels[parts.likely]).any()


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
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
