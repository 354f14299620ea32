"""Specks are no things; small visible parts of things are."""

from __future__ import annotations

import numpy as np
from forecast_worlds import GRID

from twin_node.forecast.bits import Bits
from twin_node.forecast.parts import Parts, split
from twin_node.forecast.specks import of_things
from twin_node.forecast.verdicts import Carved


def block(corner: tuple[int, int, int], side: int) -> np.ndarray:
    """Flat indices of a cube of voxels."""
    places = np.stack(np.meshgrid(*(np.arange(c, c + side) for c in corner), indexing="ij")).reshape(3, -1)
    return np.ravel_multi_index(tuple(places), GRID.dims)


def parts_of(*blocks: np.ndarray) -> Parts:
    indices = np.sort(np.concatenate(blocks))
    return split(GRID, indices, np.ones(len(indices), np.bool_))


def test_what_is_smaller_than_a_hand_is_none_unless_it_hangs_on_something() -> None:
    hand, speck, finger = block((4, 4, 4), 4), block((20, 20, 20), 1), block((9, 4, 4), 1)
    parts = parts_of(hand, speck, finger)
    kept, expected = parts.of(of_things(GRID, parts)), parts_of(hand, finger)
    assert np.array_equal(kept.indices, expected.indices)
    assert np.array_equal(kept.places, expected.places)
    assert np.array_equal(kept.labels, expected.labels)
    assert np.array_equal(kept.centers, expected.centers)


def test_nothing_at_all_is_nothing() -> None:
    assert of_things(GRID, parts_of(np.zeros(0, np.int64))).shape == (0,)


def test_what_is_no_thing_is_explained_by_nothing() -> None:
    def bits(*indices: int) -> Bits:
        return Bits.of_indices(GRID.dims, np.array(indices, np.int64))

    found = Carved(may_move=bits(1, 2, 9), likely_moves=bits(1, 9), unknown=bits(5), on_arm=bits(7)).moved_only(
        bits(1, 2)
    )
    masks = (found.may_move, found.likely_moves, found.unknown, found.on_arm)
    assert [mask.indices().tolist() for mask in masks] == [[1, 2], [1], [5, 9], [7]]
