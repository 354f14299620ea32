"""After a set is out what can wait is done, let be, or done nevertheless."""

from __future__ import annotations

from collections.abc import Iterable

from twin_node.model.slack import AT_EASE, Slack


def answering(answers: Iterable[bool]) -> object:
    """Says in turn whether no set waits."""
    left = iter(answers)
    return lambda: next(left)


def eased() -> Slack:
    """After so many sets after which none waited that one which comes meanwhile puts off what is left."""
    slack = Slack()
    for _ in range(AT_EASE):
        slack.begin(lambda: True)
        assert slack.lasts()
    return slack


def test_a_set_that_waits_leaves_no_time_and_is_counted() -> None:
    slack = eased()
    for count in (1, 2, 3):
        slack.begin(lambda: False)
        assert not slack.lasts()
        assert slack.put_off == count
    slack.begin(lambda: True)
    assert slack.lasts() and slack.put_off == 0


def test_one_that_comes_meanwhile_puts_off_what_is_left() -> None:
    slack = eased()
    slack.begin(answering([True, True, False]))
    assert slack.lasts()
    assert not slack.lasts()
    assert not slack.lasts(), "what was put off is not taken up again before the next set"
    assert slack.put_off == 1


def test_what_was_put_off_once_is_not_put_off_again() -> None:
    slack = eased()
    slack.begin(answering([True, False]))
    assert not slack.lasts()
    slack.begin(answering([True]))  # it would be asked for more if it gave way
    assert slack.lasts() and slack.lasts()


def test_where_sets_wait_often_one_that_comes_meanwhile_changes_nothing() -> None:
    slack = eased()
    slack.begin(lambda: False)
    for _ in range(AT_EASE - 1):
        slack.begin(answering([True]))
        assert slack.lasts()
    slack.begin(answering([True, False]))
    assert not slack.lasts()
