"""Tables of figures: aligned, to be read in a terminal, and as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def text_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lines with the first column to the left, the others to the right, each as wide as its widest cell.

    A row may end early: one of a single cell is a line of text below the table.
    """
    lines = [heads, *rows]
    widths = [max(len(line[i]) for line in lines if len(line) > max(i, 1)) for i in range(len(heads))]
    padded = ((line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])) for line in lines)
    return "\n".join("  ".join(line).rstrip() for line in padded)


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lines of a table in Markdown."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (heads, ("---",) * len(heads), *rows))


def figure(value: float | int | None) -> str:
    """A cell: whole numbers as they are, others to four digits; "-" for what was not measured."""
    if value is None:
        return "-"
    if isinstance(value, int):
        return str(value)
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"


def percent(share: float | None) -> str:
    """A share as a cell; empty where there is none."""
    return "" if share is None else f"{100 * share:.1f} %"
