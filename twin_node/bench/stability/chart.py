"""What the stability suite found, as lines to read and as a chart: where each method gives way."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from twin_node.bench.errors import BenchError
from twin_node.bench.stability.failures import FAILURES, UNDISTURBED
from twin_node.bench.stability.pictures import OURS
from twin_node.bench.stability.suite import METHODS, Stability

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TITLES = {
    OURS: "ours",
    "worst_case": "worst case (1.6 m/s)",
    "constant_velocity": "constant velocity",
    "persistence": "persistence",
    "frozen_first_frame": "picture: first image for ever",
    "previous_image": "picture: previous image",
}
"""In the order of the chart, and with the colours below."""
COLOURS = ("#c0392b", "#7f8c8d", "#2980b9", "#8e44ad", "#d4a017", "#27ae60")
NEVER = "-"


def text(found: Stability) -> str:
    """The table as lines."""
    names = [name for name in TITLES if name in METHODS]
    lines = [f"{'gives way at':34}" + "".join(f"{name:>20}" for name in names)]
    for failure in found.failures:
        cells = [_cell(found.gives_way(name, failure)) for name in names]
        title = f"{FAILURES[failure].title} [{FAILURES[failure].unit}]"
        lines.append(f"{title:34}" + "".join(f"{cell:>20}" for cell in cells))
    lines.append(f"{'silent failures':34}" + "".join(f"{found.silent_failures(name):>20}" for name in names))
    share = found.warning_share(OURS)
    if share is not None:
        lines.append(f"warnings of ours while nothing is wrong: {100 * share:.2f} % of the time")
    if found.isometry_error is not None:
        lines.append(f"elastic jelly: a rigid box's distances change by {100 * found.isometry_error:.1f} % in 200 ms")
    lines += [f"ghost, {name}: {100 * value:.0f} % of its energy is left" for name, value in found.ghost.items()]
    return "\n".join(lines)


def markdown(found: Stability) -> str:
    """The table of levels at which each method gives way, as Markdown."""
    names = [name for name in TITLES if name in METHODS]
    lines = [
        "| failure, levels tried | " + " | ".join(TITLES[name] for name in names) + " |",
        "|" + " --- |" * (len(names) + 1),
    ]
    for failure, levels in found.failures.items():
        one = FAILURES[failure]
        tried = ", ".join(f"{level.level:g}" for level in levels)
        cells = [_cell(found.gives_way(name, failure)) for name in names]
        lines.append(f"| {one.title}: {tried} {one.unit} | " + " | ".join(cells) + " |")
    lines.append("| silent failures | " + " | ".join(str(found.silent_failures(name)) for name in names) + " |")
    return "\n".join(lines) + "\n"


def draw(found: Stability, folder: Path) -> Path:
    """`stability.png` and `stability.svg` in `folder`: a row per failure, a mark where each method gives way.

    Raises `BenchError` where they cannot be written.
    """
    from matplotlib.figure import Figure

    rows = [name for name in found.failures if name not in UNDISTURBED]
    figure = Figure(figsize=(11, 0.34 * len(rows) + 1.8), layout="constrained")
    axes = figure.add_subplot()
    for row, failure in enumerate(rows):
        _draw_row(axes, row, failure, found)
    axes.set_yticks(range(len(rows)), [f"{FAILURES[name].title} [{FAILURES[name].unit}]" for name in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlim(0, 1.16)
    axes.set_xticks([0.0, 1.0, 1.1], ["easy", "hardest level tried", "never"])
    axes.axvspan(1.05, 1.16, color="#eef6ee")
    axes.set_title("Where each method gives way: recall at 200 ms under 95 %, or a picture under 15 dB", loc="left")
    axes.spines[["top", "right", "left"]].set_visible(False)
    handles, labels = axes.get_legend_handles_labels()
    by_label = dict(zip(labels, handles, strict=True))
    figure.legend(by_label.values(), by_label, loc="outside lower center", ncols=3, frameon=False)
    path = folder / "stability.png"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=100)
        figure.savefig(path.with_suffix(".svg"))
    except OSError as error:
        raise BenchError(
            f"--out {folder}: cannot write {path.name} ({error.strerror}); choose another folder"
        ) from error
    return path


def _draw_row(axes: Axes, row: int, failure: str, found: Stability) -> None:
    """The levels as ticks, evenly spaced, and each method's mark where it gives way; at the right if it never does."""
    levels = [one.level for one in found.failures[failure]]
    places = {level: (index + 1) / len(levels) for index, level in enumerate(levels)}
    axes.plot([0, 1], [row, row], color="#dddddd", linewidth=1, zorder=0)
    for level, place in places.items():
        axes.annotate(
            f"{level:g}", (place, row), (0, -9), "data", "offset points", ha="center", fontsize=6, color="#999999"
        )
    count = len(TITLES)
    for index, ((name, title), colour) in enumerate(zip(TITLES.items(), COLOURS, strict=True)):
        if name not in METHODS:
            continue
        gives_way = found.gives_way(name, failure)
        aside = 0.007 * (index - (count - 1) / 2)
        place = 1.1 if gives_way is None else places[gives_way]
        axes.plot(
            place + aside,
            row,
            "o" if name == OURS else "|",
            color=colour,
            label=title,
            markersize=9 if name != OURS else 8,
            markeredgewidth=2,
        )


def _cell(level: float | None) -> str:
    return NEVER if level is None else f"{level:g}"
