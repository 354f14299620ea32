"""What the stability suite found, as lines to read and as a chart: where each method gives way."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from twin_node.bench.contenders import BASELINES, OURS
from twin_node.bench.results_folder import save_chart
from twin_node.bench.stability.failures import FAILURES
from twin_node.bench.stability.suite import OUR_PICTURES, Stability
from twin_node.bench.text_table import markdown_table, text_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TITLES = {
    OURS: "ours",
    "worst_case": "worst case (1.6 m/s)",
    "constant_velocity": "constant velocity",
    "persistence": "persistence",
    OUR_PICTURES: "picture: ours",
    "frozen_first_frame": "picture: first image for ever",
    "previous_image": "picture: previous image",
}
"""In the order of the chart, and with the colours below."""
COLOURS = ("#c0392b", "#7f8c8d", "#2980b9", "#4a235a", "#641e16", "#d4a017", "#7fd6a0")
NEVER = "-"


def text(found: Stability) -> str:
    """The table as lines."""
    rows = [
        (
            f"{FAILURES[failure].title} [{FAILURES[failure].unit}]",
            *(_cell(found.gives_way(name, failure)) for name in TITLES),
        )
        for failure in found.failures
    ]
    rows.append(("silent failures", *(_silent(found, name) for name in TITLES)))
    lines = [text_table(("gives way at", *TITLES), rows)]
    share = found.warning_share(OURS)
    if share is not None:
        lines.append(f"warnings of ours while nothing is wrong: {100 * share:.2f} % of the time")
    if found.isometry_error is not None:
        lines.append(f"elastic jelly: a rigid box's distances change by {100 * found.isometry_error:.1f} % in 200 ms")
    lines += [f"ghost, {name}: {100 * value:.0f} % of its energy is left" for name, value in found.ghost.items()]
    return "\n".join(lines)


def markdown(found: Stability) -> str:
    """The table of levels at which each method gives way, as Markdown."""
    rows = []
    for failure, levels in found.failures.items():
        one = FAILURES[failure]
        tried = ", ".join(f"{level.level:g}" for level in levels)
        cells = (_cell(found.gives_way(name, failure)) for name in TITLES)
        rows.append((f"{one.title}: {tried} {one.unit}", *cells, _blocked(found, failure)))
    rows.append(("silent failures", *(_silent(found, name) for name in TITLES), ""))
    heads = ("failure, levels tried", *TITLES.values(), "litres, ours / worst case")
    return markdown_table(heads, rows) + "\n"


def draw(found: Stability, folder: Path) -> Path:
    """`stability.png` and `stability.svg` in `folder`; raises `BenchError` where they cannot be written."""
    return save_chart(drawn(found), folder, "stability")


def drawn(found: Stability) -> Figure:
    """The chart: a row per failure, a bar per method as long as it holds."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    rows = list(found.failures)
    figure = Figure(figsize=(11, 0.5 * len(rows) + 1.8), layout="constrained")
    axes = figure.add_subplot()
    for row, failure in enumerate(rows):
        _draw_row(axes, row, failure, found)
    axes.set_yticks(range(len(rows)), [_row_title(name, found) for name in rows], fontsize=8)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlim(0, NEVER_ENDS)
    axes.set_xticks([0.0, 1.0, NEVER_ENDS], ["gives way at the first level", "at the hardest level", "never"])
    axes.axvspan(1.0, NEVER_ENDS, color="#eef6ee", zorder=0)
    axes.set_title("How far each method holds: recall at 200 ms of 95 %, or a picture of 15 dB", loc="left")
    axes.set_title("litres blocked:\nours / worst case", loc="right", fontsize=8)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(left=False)
    handles = [Patch(color=colour, label=TITLES[name]) for name, colour in zip(TITLES, COLOURS, strict=True)]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure


NEVER_ENDS = 1.15
"""Length of the bar of a method that holds at every level, where 1 is the hardest one."""
LEAST_BAR = 0.006
"""Length of the bar of a method that gives way at the first level, so that it is seen."""


def _row_title(failure: str, found: Stability) -> str:
    levels = ", ".join(f"{one.level:g}" for one in found.failures[failure])
    return f"{FAILURES[failure].title}\n{levels} {FAILURES[failure].unit}"


def _draw_row(axes: Axes, row: int, failure: str, found: Stability) -> None:
    """A bar per method that ends at the first level at which it gives way, the levels evenly between 0 and 1."""
    levels = [one.level for one in found.failures[failure]]
    places = {level: index / max(len(levels) - 1, 1) for index, level in enumerate(levels)}
    height = 0.8 / len(TITLES)
    for index, (name, colour) in enumerate(zip(TITLES, COLOURS, strict=True)):
        gives_way = found.gives_way(name, failure)
        length = NEVER_ENDS if gives_way is None else max(places[gives_way], LEAST_BAR)
        axes.barh(row + (index - (len(TITLES) - 1) / 2) * height, length, height, color=colour)
    blocked = _blocked(found, failure)
    axes.annotate(blocked, (NEVER_ENDS, row), (6, -3), textcoords="offset points", fontsize=8, annotation_clip=False)
    for level in levels[1:]:
        axes.plot([places[level]] * 2, [row - 0.42, row + 0.42], color="white", linewidth=1)


def _blocked(found: Stability, failure: str) -> str:
    """Litres that ours and the worst case block, mean over the levels."""
    litres = (found.blocked_l(name, failure) for name in (OURS, "worst_case"))
    return " / ".join("-" if value is None else f"{value:.0f}" for value in litres)


def _silent(found: Stability, name: str) -> str:
    """Silent failures of a method that forecasts; pictures promise nothing."""
    return str(found.silent_failures(name)) if name == OURS or name in BASELINES else ""


def _cell(level: float | None) -> str:
    return NEVER if level is None else f"{level:g}"
