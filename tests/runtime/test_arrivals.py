"""Which messages are left for the next: those that are old, of streams that keep time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.runtime.arrivals import GAPS, LATE, Arrivals


def stream(gaps: list[float], patience: float = 0.5) -> Arrivals:
    """A stream whose last message came at 100 s."""
    arrivals, now = Arrivals(patience), 100.0 - sum(gaps)
    arrivals.add(now)
    for gap in gaps:
        now += gap
        arrivals.add(now)
    return arrivals


STEADY = [0.04] * GAPS


def test_a_young_message_is_taken_and_an_old_one_left() -> None:
    arrivals = stream(STEADY)
    assert arrivals.worth_waiting_s(100.0) == 0
    assert arrivals.worth_waiting_s(100.019) == 0
    assert arrivals.worth_waiting_s(100.021) == pytest.approx(0.019 + LATE * 0.04)


def test_what_does_not_come_is_not_waited_for() -> None:
    arrivals = stream(STEADY)
    assert arrivals.worth_waiting_s(100.04) == pytest.approx(LATE * 0.04)
    assert arrivals.worth_waiting_s(100.0501) == 0
    assert arrivals.worth_waiting_s(200.0) == 0


def test_without_patience_or_a_record_what_is_there_is_taken() -> None:
    assert stream(STEADY, patience=0.0).worth_waiting_s(100.03) == 0
    assert stream(STEADY[1:]).worth_waiting_s(100.03) == 0
    assert Arrivals(0.5).worth_waiting_s(0.0) == 0


def test_one_pause_does_not_change_what_is_expected() -> None:
    assert stream([*STEADY[1:], 3.0]).worth_waiting_s(100.03) == pytest.approx(0.01 + LATE * 0.04)


@given(st.lists(st.floats(0.0, 10.0), min_size=GAPS, max_size=3 * GAPS), st.floats(0.0, 20.0))
def test_a_wait_never_takes_longer_than_it_is_worth(gaps: list[float], after: float) -> None:
    wait = stream(gaps).worth_waiting_s(100.0 + after)
    assert 0 <= wait <= (0.5 + LATE) * max(gaps) + 1e-9
