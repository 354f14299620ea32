"""After a set is out what can wait is done, let be, or done nevertheless."""

from __future__ import annotations

from collections.abc import Iterable

from twin_node.model.leisure import AT_EASE, Leisure


def answering(answers: Iterable[bool]) -> object:
    """Says in turn whether no set waits."""
    left = iter(answers)
    return lambda: next(left)


def eased() -> Leisure:
    """After so many sets after which none waited that one which comes meanwhile puts off what is left."""
    leisure = Leisure()
    for _ in range(AT_EASE):
        leisure.begin(lambda: True)
        assert leisure.lasts()
    return leisure


def test_a_set_that_waits_leaves_no_time_and_is_counted() -> None:
    leisure = eased()
    for count in (1, 2, 3):
        leisure.begin(lambda: False)
        assert not leisure.lasts()
        assert leisure.put_off == count
    leisure.begin(lambda: True)
    assert leisure.lasts() and leisure.put_off == 0


def test_one_that_comes_meanwhile_puts_off_what_is_left() -> None:
    leisure = eased()
    leisure.begin(answering([True, True, False]))
    assert leisure.lasts()
    assert not leisure.lasts()
    assert not leisure.lasts(), "what was put off is not taken up again before the next set"
    assert leisure.put_off == 1


def test_what_was_put_off_once_is_not_put_off_again() -> None:
    leisure = eased()
    leisure.begin(answering([True, False]))
    assert not leisure.lasts()
    leisure.begin(answering([True]))  # it would be asked for more if it gave way
    assert leisure.lasts() and leisure.lasts()


def test_where_sets_wait_often_one_that_comes_meanwhile_changes_nothing() -> None:
    leisure = eased()
    leisure.begin(lambda: False)
    for _ in range(AT_EASE - 1):
        leisure.begin(answering([True]))
        assert leisure.lasts()
    leisure.begin(answering([True, False]))
    assert not leisure.lasts()
