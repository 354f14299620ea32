"""Few of many."""

from __future__ import annotations

import itertools

import pytest

from twin_node.thinning import Thinning, thinned


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


@pytest.mark.parametrize("most", [0, 1, 3, 6])
def test_of_what_comes_one_after_another_few_are_ever_held(most: int) -> None:
    for count in (0, 1, most, 2 * most, 50, 600):
        thinning: Thinning[int] = Thinning(most)
        for item in range(count):
            thinning.add(item)
            assert thinning.held <= 2 * most
        picked = thinning.picked()
        assert len(picked) == min(count, most)
        if most > 1 and count > most:
            gaps = [after - before for before, after in itertools.pairwise(picked)]
            assert picked[0] == 0 and picked[-1] >= 0.7 * count and 0 < max(gaps) <= 3 * min(gaps)
