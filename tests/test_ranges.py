"""Spans of time as errors tell them."""

from __future__ import annotations

import pytest

from twin_node.nodes.export import ExportError, ExportSpan
from twin_node.ranges import within_s

LENGTH_NS = 636_805_996
"""A length that rounds up: 0.637 s."""


@pytest.mark.parametrize(
    ("seconds", "told"),
    [(LENGTH_NS / 1e9, "0 to 0.636 s"), (1.4, "0 to 1.400 s"), (1.001, "0 to 1.001 s"), (0, "0 to 0.000 s")],
)
def test_a_span_is_not_told_longer_than_it_is(seconds: float, told: str) -> None:
    assert within_s(seconds) == told


def test_who_asks_for_the_end_that_an_error_tells_gets_it() -> None:
    """Asked for 0.637 s, an export said that it expected a time inside 0 to 0.637 s."""
    with pytest.raises(ExportError, match=r"expected a span inside the log's 0 to 0\.636 s"):
        ExportSpan.one(0.637).stamps(0, LENGTH_NS)
    assert ExportSpan.one(0.636).stamps(0, LENGTH_NS) == [636_000_000]
