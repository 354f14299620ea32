"""Boxes on an octree: all that is occupied inside, few, and small where that spares space."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast.bits import Bits
from twin_node.forecast.boxes import (
    Boxes,
    fitted,
    mostly_full,
    smallest_boxes,
)
from twin_node.forecast.covering import Covers, Share, Wanted, covers, covers_reference
from twin_node.forecast.errors import ForecastError
from twin_node.scene import Bool, Grid

GRID = Grid(np.zeros(3), 0.02, (50, 37, 29))
NO_PLACES = np.zeros(0, np.int64)


def filled(boxes: Boxes) -> Bool:
    """[grid] True inside the boxes."""
    dense = np.zeros(GRID.dims, np.bool_)
    for lower, upper in zip(boxes.lower, boxes.upper + 1, strict=True):
        dense[tuple(slice(a, b) for a, b in zip(lower, upper, strict=True))] = True
    return dense


def space(boxes: Boxes) -> int:
    return int(np.prod(boxes.upper - boxes.lower + 1, axis=1).sum())


def blobs(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    dense = np.zeros(GRID.dims, np.bool_)
    for _ in range(count):
        start = rng.integers(0, GRID.dims)
        stop = start + rng.integers(1, 15, 3)
        dense[tuple(slice(a, b) for a, b in zip(start, stop, strict=True))] = True
    return np.flatnonzero(dense)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 12), most=st.integers(1, 60))
def test_few_boxes_hold_every_voxel(seed: int, count: int, most: int) -> None:
    voxels = blobs(seed, count)
    boxes = fitted(GRID, smallest_boxes(GRID, voxels), most, NO_PLACES)
    assert len(boxes) <= most
    assert filled(boxes).reshape(-1)[voxels].all()
    assert len(np.unique(boxes.places(GRID))) == len(boxes)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_more_boxes_hold_no_more_space(seed: int) -> None:
    smallest = smallest_boxes(GRID, blobs(seed, 8))
    spaces = [space(fitted(GRID, smallest, most, NO_PLACES)) for most in (1, 4, 16, 64)]
    assert spaces == sorted(spaces, reverse=True)
    assert spaces[-1] >= space(smallest)


def test_far_small_things_keep_boxes_of_their_own() -> None:
    """Two voxels in opposite corners and a block: three boxes are enough for no space to be wasted on the corners."""
    dense = np.zeros(GRID.dims, np.bool_)
    dense[0, 0, 0] = dense[-1, -1, -1] = True
    dense[16:32, 16:32, 8:16] = True
    boxes = fitted(GRID, smallest_boxes(GRID, np.flatnonzero(dense)), 6, NO_PLACES)
    assert space(boxes) < 1.3 * dense.sum()


def test_one_box_holds_even_a_grid_longer_than_the_largest_cell() -> None:
    long = Grid(np.zeros(3), 0.02, (1100, 4, 4))
    wanted = [Wanted(long, 1, 0, (np.array([0, 9000, long.size - 1]), np.zeros(0, int)))]
    found = covers(wanted, np.zeros(0, np.uint32))
    assert np.array_equal(found.lower, [[0, 0, 0]])
    assert np.array_equal(found.upper, [[1099, 3, 3]])
    assert same(found, covers_reference(wanted, np.zeros(0, np.uint32)))


def test_an_earlier_cover_is_kept_where_it_is_nearly_as_good() -> None:
    """Boxes of a thing that is cut short."""
    voxels = blobs(3, 10)
    first = fitted(GRID, smallest_boxes(GRID, voxels), 12, NO_PLACES).places(GRID)
    cut = smallest_boxes(GRID, voxels[np.unravel_index(voxels, GRID.dims)[0] >= 5])
    kept, anew = (fitted(GRID, cut, 12, before).places(GRID) for before in (first, NO_PLACES))
    assert np.isin(kept, first).all()
    assert not np.isin(anew, first).all()


@pytest.mark.parametrize("voxels", [np.array([3, GRID.size], np.uint32), np.array([-1, 3])])
def test_voxels_beside_the_grid_are_refused(voxels: np.ndarray) -> None:
    """Compiled code keeps a box for each of the grid's cells: beside them lies something else."""
    with pytest.raises(ForecastError, match=f"expected flat indices of the grid's {GRID.size} voxels, found"):
        covers([Wanted(GRID, 5, 0, (voxels[:0], voxels))], np.zeros(0, np.uint32))


def test_masks_of_another_grid_are_refused() -> None:
    with pytest.raises(ForecastError, match=r"expected a mask of .* voxels, as the grid has, found \(3, 4, 5\)"):
        covers([Wanted(GRID, 5, 0, Share(Bits.all((3, 4, 5)), 0.5))], np.zeros(0, np.uint32))


def same(one: Covers, other: Covers) -> bool:
    return all(np.array_equal(value, vars(other)[name]) for name, value in vars(one).items())


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 12), most=st.integers(1, 60))
def test_compiled_covers_are_the_plain_ones(seed: int, count: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    voxels = rng.permutation(np.concatenate([blobs(seed, count), rng.integers(0, GRID.size, count), np.zeros(1, int)]))
    other = Grid(np.ones(3), 0.02, (61, 20, 70))
    mask = Bits.of_mask(GRID.dims, np.isin(np.arange(GRID.size), voxels))
    wanted = [
        Wanted(GRID, most, 0, (voxels, voxels[::3])),
        Wanted(other, most, 9, (rng.integers(0, other.size, 5 * count),)),
        Wanted(GRID, most, 200, Share(mask, 0.5)),
        Wanted(GRID, most, 7, (voxels[:0], voxels[:0])),
    ]
    first = covers(wanted, np.zeros(0, np.uint32))
    assert same(first, covers_reference(wanted, np.zeros(0, np.uint32)))
    assert len(first.ids) == first.counts.sum() and (first.counts <= most).all() and first.counts[3] == 0
    fewer = [Wanted(GRID, most, 0, (voxels[::3],)), *wanted[1:]]
    before = rng.permutation(first.ids)
    assert same(covers(fewer, before), covers_reference(fewer, before))


def test_cells_count_from_their_share_on() -> None:
    dense = np.zeros(GRID.dims, np.bool_)
    dense[:4, :4, :2] = dense[8:12, :4, :1] = True
    assert np.array_equal(mostly_full(GRID, Bits.of_mask(GRID.dims, dense), 0.5).cells, [[0, 0, 0]])
    assert len(mostly_full(GRID, Bits.of_mask(GRID.dims, dense), 0.25)) == 2


def test_cells_cut_by_the_grids_end_count_by_what_is_left_of_them() -> None:
    """The last cells of a grid of 50 x 37 x 29 are 2 x 1 x 1 voxels in size."""
    corner = np.zeros(GRID.dims, np.bool_)
    corner[48:, 36:, 28:] = True
    assert np.array_equal(mostly_full(GRID, Bits.of_mask(GRID.dims, corner), 0.5).lower, [[48, 36, 28]])
    assert len(mostly_full(GRID, Bits.none(GRID.dims), 0.0)) == 0
