"""Speed against accuracy as a chart: pixels of a camera left out against the time of a set."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from twin_node.bench.pareto.front import dominates, is_ours, pictures
from twin_node.bench.pareto.measure import OURS, Point
from twin_node.bench.pareto.suite import Pareto
from twin_node.bench.results_folder import save_chart
from twin_node.nodes.sizes import SIZES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.transforms import Bbox

OURS_COLOUR, ONLINE_COLOUR, OFFLINE_COLOUR = "#c0392b", "#2c3e50", "#7f8c99"
LABEL_SIZE, LETTER_SIZE = 8, 7
"""Heights of the letters of names and of our sizes, points."""
_PLACES = (
    ((8, 0), "left", "center"),
    ((-8, 0), "right", "center"),
    ((0, 8), "center", "bottom"),
    ((0, -8), "center", "top"),
    ((8, 8), "left", "bottom"),
    ((-8, -8), "right", "top"),
    ((8, -8), "left", "top"),
    ((-8, 8), "right", "bottom"),
    ((0, 22), "center", "bottom"),
    ((0, -22), "center", "top"),
)
"""Where a name may stand beside its mark, best first: offset in points, alignments."""


def draw(found: Pareto, folder: Path) -> Path:
    """`pareto.png` and `pareto.svg` in `folder`: a panel per data set. Raises `BenchError` where it cannot write."""
    from matplotlib.figure import Figure

    data = found.by_data()
    figure = Figure(figsize=(6.2 * len(data), 5.6), layout="constrained")
    panels = figure.subplots(1, len(data), squeeze=False)[0]
    marks = [[_Mark.of(one, found) for one in points if one.psnr_left_out_db is not None] for points in data.values()]
    for axes, name, shown in zip(panels, data, marks, strict=True):
        axes.set_title(name, loc="left")
        _draw_marks(axes, shown)
    panels[0].set_ylabel("moving pixels of a camera left out, dB")
    figure.supxlabel("ms per set of images, one core (offline: whole training over the sets)", fontsize=10)
    named = panels[0].get_legend_handles_labels()
    figure.legend(*named, loc="outside upper center", ncols=2 * len(data), frameon=False)
    figure.draw_without_rendering()
    for axes, shown in zip(panels, marks, strict=True):
        _name_marks(axes, shown)
    return save_chart(figure, folder, "pareto")


@dataclass(frozen=True)
class _Mark:
    """Where a method stands on the chart."""

    method: str
    """The same for all numbers of steps of one method."""
    title: str
    ms: float
    db: float
    colour: str
    shape: str
    letter: str
    """Of our sizes, the first one."""
    on_front: bool

    @staticmethod
    def of(point: Point, found: Pareto) -> _Mark:
        """Of a method with pictures of a camera left out."""
        colour = OURS_COLOUR if is_ours(point) else ONLINE_COLOUR if point.online else OFFLINE_COLOUR
        shape = "o" if is_ours(point) else "s" if point.online else "^"
        is_first = point.online and not any(one.online and dominates(one, point, pictures) for one in found.points)
        letter = point.name.removeprefix(f"{OURS}_")[0] if is_ours(point) else ""
        method = point.name.partition(":")[0]
        return _Mark(
            method, point.title, point.ms_per_frame, point.psnr_left_out_db or 0, colour, shape, letter, is_first
        )


def _draw_marks(axes: Axes, marks: Sequence[_Mark]) -> None:
    """Marks, the same method trained for longer joined by a line, our sizes as letters."""
    for same in _by_method(marks):
        axes.plot([one.ms for one in same], [one.db for one in same], ":", color=same[0].colour, linewidth=1)
        for one in same:
            axes.plot(one.ms, one.db, one.shape, color=one.colour, markersize=11 if one.letter else 7, alpha=0.85)
            axes.text(
                one.ms, one.db, one.letter, color="white", fontsize=LETTER_SIZE, weight="bold", ha="center", va="center"
            )
    for label, shape, colour in (
        (f"ours: {', '.join(SIZES)}", "o", OURS_COLOUR),
        ("other online methods", "s", ONLINE_COLOUR),
        ("offline, dotted: trained for longer", "^", OFFLINE_COLOUR),
    ):
        axes.plot([], [], shape, label=label, color=colour, markersize=8)
    front, label = _front(marks), "front of the online methods"
    times, values = [one.ms for one in front], [one.db for one in front]
    axes.step(times, values, where="post", label=label, color=OURS_COLOUR, linewidth=1, alpha=0.5)
    axes.set_xscale("log")
    axes.margins(x=0.25, y=0.1)
    axes.grid(color="#eeeeee")


def _front(marks: Sequence[_Mark]) -> list[_Mark]:
    return sorted((one for one in marks if one.on_front), key=lambda one: one.ms)


def _by_method(marks: Sequence[_Mark]) -> Iterator[list[_Mark]]:
    """The marks of one method after another, each in rising order of time."""
    for method in dict.fromkeys(one.method for one in marks):
        yield sorted((one for one in marks if one.method == method), key=lambda one: one.ms)


def _name_marks(axes: Axes, marks: Sequence[_Mark]) -> None:
    """Every method's name once, beside its slowest mark, where it covers least of what is drawn and of the edge."""
    taken = _drawn(axes, marks)
    for same in _by_method([one for one in marks if not one.letter]):
        last, title = same[-1], min((one.title for one in same), key=len)
        names = [
            axes.annotate(
                title,
                (last.ms, last.db),
                offset,
                "data",
                "offset points",
                ha=across,
                va=upright,
                fontsize=LABEL_SIZE,
                color=last.colour,
            )
            for offset, across, upright in _PLACES
        ]
        boxes = [name.get_window_extent() for name in names]
        covered = [sum(_overlap(box, one) for one in taken) - _overlap(box, axes.bbox) for box in boxes]
        best = covered.index(min(covered))
        taken.append(boxes[best])
        for name in names[:best] + names[best + 1 :]:
            name.remove()


def _drawn(axes: Axes, marks: Sequence[_Mark]) -> list[Bbox]:
    """What names should not cover, in pixels: marks, and the level stretches of the front."""
    from matplotlib.transforms import Bbox

    def at(one: _Mark) -> tuple[float, float]:
        x, y = axes.transData.transform((one.ms, one.db))
        return float(x), float(y)

    places = [at(one) for one in marks]
    steps = [(at(one), at(after)) for one, after in pairwise(_front(marks))]
    return [Bbox.from_extents(x - 8, y - 8, x + 8, y + 8) for x, y in places] + [
        Bbox.from_extents(x, y - 3, x_after, y + 3) for (x, y), (x_after, _) in steps
    ]


def _overlap(one: Bbox, other: Bbox) -> float:
    """Pixels that two boxes share."""
    wide, high = min(one.x1, other.x1) - max(one.x0, other.x0), min(one.y1, other.y1) - max(one.y0, other.y0)
    return float(max(wide, 0) * max(high, 0))
