"""Few of many."""

from __future__ import annotations

import pytest

from twin_node.thinning import thinned


@pytest.mark.parametrize(
    ("count", "most", "expected"),
    [(0, 3, []), (2, 3, [0, 1]), (3, 3, [0, 1, 2]), (9, 1, [0]), (9, 3, [0, 4, 8]), (10, 4, [0, 3, 6, 9])],
)
def test_what_is_picked_is_spread_and_in_order(count: int, most: int, expected: list[int]) -> None:
    assert thinned(list(range(count)), most) == expected


def test_none_is_picked_twice() -> None:
    for count in range(1, 60):
        for most in range(1, 60):
            picked = thinned(range(count), most)
            assert len(set(picked)) == len(picked) == min(count, most)
