"""Tables for people: columns in line whatever is in them."""

from __future__ import annotations

import pytest

from twin_node.bench.text_table import figure, text_table


def test_columns_are_as_wide_as_their_widest_cells_and_a_line_of_text_widens_none() -> None:
    rows = [("short", "1"), ("a long name", "100", "x"), ("text that belongs to no column",)]
    assert text_table(("", "one", "two"), rows).splitlines() == [
        "             one  two",
        "short          1",
        "a long name  100    x",
        "text that belongs to no column",
    ]


@pytest.mark.parametrize(
    ("value", "told"),
    [(None, "-"), (12345, "12345"), (0.123456, "0.1235"), (23.0, "23"), (9999.9, "10000"), (123456.7, "123457")],
)
def test_figures_have_four_digits_and_whole_numbers_all_of_theirs(value: float | None, told: str) -> None:
    assert figure(value) == told
