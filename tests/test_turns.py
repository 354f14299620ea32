"""Turns: one after the other, and whoever has waited longest where not all are there."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from twin_node.turns import Turns


def taken(sets: list[str]) -> list[str]:
    """Who is taken of each set of names, one letter each."""
    turns, found = Turns(), []
    for names in sets:
        found.append(names[turns.whose(names)])
        turns.take([found[-1]])
    return found


def test_where_all_are_there_each_has_every_so_manieth_turn() -> None:
    assert "".join(taken(["abc"] * 7)) == "bcabcab"


def test_who_is_in_every_second_set_has_a_turn_in_each() -> None:
    assert taken(["ab", "a"] * 10)[::2] == ["b"] * 10


def test_after_a_turn_of_all_it_goes_on_in_the_row() -> None:
    turns = Turns()
    turns.take("abc")
    assert turns.whose("abc") == 1
    turns.take("b")
    assert turns.whose("abc") == 2


@given(st.lists(st.sets(st.sampled_from("abcd"), min_size=1).map("".join), min_size=1, max_size=60))
def test_nobody_who_is_there_waits_for_more_than_one_turn_of_each_other(sets: list[str]) -> None:
    found, waited = taken(sets), Counter[str]()
    for names, one in zip(sets, found, strict=True):
        waited.update(name for name in names if name != one)
        waited[one] = 0
        assert max(waited.values()) <= 3
