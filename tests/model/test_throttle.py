"""Work that comes round again after some time."""

from __future__ import annotations

from itertools import pairwise

import pytest

from twin_node.model.throttle import Throttle

MS = 1_000_000


@pytest.mark.parametrize("gap_ms", [10, 33, 100, 1000])
def test_work_is_done_at_first_and_then_once_per_period_however_quickly_sets_come(gap_ms: int) -> None:
    throttle, done = Throttle(0.1), []
    for stamp in range(7, 7 + 4000 * MS, gap_ms * MS):
        if throttle.is_due(stamp):
            done.append(stamp)
    assert done[0] == 7
    gaps = {later - earlier for earlier, later in pairwise(done)}
    assert gaps == {max(gap_ms, -(-100 // gap_ms) * gap_ms) * MS}


def test_each_work_has_a_rhythm_of_its_own() -> None:
    often, seldom = Throttle(0.0), Throttle(0.5)
    assert [(often.is_due(stamp * MS), seldom.is_due(stamp * MS)) for stamp in (0, 499, 500)] == [
        (True, True),
        (True, False),
        (True, True),
    ]
