"""Speed against accuracy as a chart and as tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin_node.bench.pareto.front import dominated_sizes, dominates, is_ours, on_front, pictures
from twin_node.bench.pareto.hexplane import against_hexplane, said
from twin_node.bench.pareto.measure import OURS, Point
from twin_node.bench.pareto.suite import Pareto
from twin_node.bench.results_folder import save_chart
from twin_node.nodes.sizes import SIZES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS: dict[str, Callable[[Point], float | int | None]] = {
    "ms/frame": lambda point: point.ms_per_frame,
    "latency ms": lambda point: point.latency_ms,
    "draw ms": lambda point: point.draw_ms,
    "moving dB": lambda point: point.psnr_moving_db,
    "all dB": lambda point: point.psnr_db,
    "SSIM": lambda point: point.ssim,
    "left out, moving dB": lambda point: point.psnr_left_out_db,
    "left out, SSIM": lambda point: point.ssim_left_out,
    "track mm": lambda point: point.track_mm,
    "recall": lambda point: point.recall,
    "litres": lambda point: point.volume_l,
    "forecast ms": lambda point: point.forecast_ms,
    "kB/frame": lambda point: None if point.bytes_per_frame is None else point.bytes_per_frame / 1e3,
    "parameters": lambda point: point.parameters,
    "MB": lambda point: point.memory_mb,
}
"""Heading -> what stands below it."""
OURS_COLOUR, ONLINE_COLOUR, OFFLINE_COLOUR = "#c0392b", "#2c3e50", "#9aa5b1"


def text(found: Pareto) -> str:
    """The tables as lines."""
    lines = []
    for data, points in _by_data(found).items():
        lines.append(f"{data} (* online, = on the front; times of one core)")
        lines.append(f"{'':34}" + "".join(f"{name:>20}" for name in COLUMNS))
        for point in points:
            marks = f"{' *' if point.online else ''}{' =' if on_front(point, found.points) else ''}"
            cells = "".join(f"{_cell(value(point)):>20}" for value in COLUMNS.values())
            lines.append(f"{point.title + marks:34}{cells}")
    return "\n".join([*lines, *_verdicts(found)])


def markdown(found: Pareto) -> str:
    """The tables as Markdown."""
    lines = []
    for data, points in _by_data(found).items():
        lines += [
            f"### {data}",
            "",
            "| method (\\* online, **on the front**) | " + " | ".join(COLUMNS) + " |",
            "|" + " --- |" * (len(COLUMNS) + 1),
        ]
        for point in points:
            title = point.title + (" \\*" if point.online else "")
            title = f"**{title}**" if on_front(point, found.points) else title
            lines.append(f"| {title} | " + " | ".join(_cell(value(point)) for value in COLUMNS.values()) + " |")
        lines.append("")
    return "\n".join([*lines, *(f"- {verdict}" for verdict in _verdicts(found))]) + "\n"


def _verdicts(found: Pareto) -> list[str]:
    """What the points say of ours, in a line each."""
    lines = []
    for point in found.points:
        sizes = dominated_sizes(point, found.points)
        if sizes:
            lines.append(
                f"{point.data}: {point.title} is no worse in anything, and better in something: {', '.join(sizes)}"
            )
    if not lines:
        lines.append("no online method dominates any of our sizes")
    return lines + [said(one) for one in against_hexplane(found.points)]


def draw(found: Pareto, folder: Path) -> Path:
    """`pareto.png` and `pareto.svg` in `folder`: a panel per data set. Raises `BenchError` where it cannot write."""
    from matplotlib.figure import Figure

    data = _by_data(found)
    figure = Figure(figsize=(6.2 * len(data), 5.2), layout="constrained")
    panels = figure.subplots(1, len(data), squeeze=False)[0]
    for axes, (name, points) in zip(panels, data.items(), strict=True):
        places = [_Place.of(point, found) for point in points if point.psnr_left_out_db is not None]
        _draw_panel(axes, name, sorted(places, key=lambda one: one.ms))
    panels[0].set_ylabel("moving pixels of a camera left out, dB")
    return save_chart(figure, folder, "pareto")


@dataclass(frozen=True)
class _Place:
    """Where a method stands on the chart."""

    title: str
    ms: float
    db: float
    colour: str
    marker: str
    letter: str
    """Of our sizes, the first one."""
    on_front: bool

    @staticmethod
    def of(point: Point, found: Pareto) -> _Place:
        """Of a method with pictures of a camera left out."""
        colour = OURS_COLOUR if is_ours(point) else ONLINE_COLOUR if point.online else OFFLINE_COLOUR
        marker = "o" if is_ours(point) else "s" if point.online else "^"
        is_first = point.online and not any(one.online and dominates(one, point, pictures) for one in found.points)
        letter = point.name.removeprefix(f"{OURS}_")[0] if is_ours(point) else ""
        return _Place(point.title, point.ms_per_frame, point.psnr_left_out_db or 0.0, colour, marker, letter, is_first)


def _draw_panel(axes: Axes, name: str, places: Sequence[_Place]) -> None:
    """Places in rising order of time; neighbours' names stand above and below in turn, ours are letters."""
    middle = float(np.sqrt(places[0].ms * places[-1].ms)) if places else 1.0
    for index, one in enumerate(places):
        axes.plot(one.ms, one.db, one.marker, color=one.colour, markersize=11 if one.letter else 7, alpha=0.85)
        if one.letter:
            axes.text(one.ms, one.db, one.letter, color="white", fontsize=7, weight="bold", ha="center", va="center")
            continue
        side = "left" if one.ms < middle else "right"
        aside = (7 if side == "left" else -7, 5 if index % 2 else -10)
        axes.annotate(
            one.title, (one.ms, one.db), aside, "data", "offset points", ha=side, fontsize=7, color=one.colour
        )
    front = [one for one in places if one.on_front]
    label, times, values = "front of the online methods", [one.ms for one in front], [one.db for one in front]
    sizes = f"ours: {', '.join(SIZES)}"
    axes.plot([], [], "o", color=OURS_COLOUR, markersize=9, label=sizes)
    axes.step(times, values, where="post", label=label, color=OURS_COLOUR, linewidth=1, alpha=0.5)
    axes.set_xscale("log")
    axes.margins(x=0.25, y=0.1)
    axes.set_xlabel("ms per set of images, one core (offline: whole training over the sets)")
    axes.set_title(name, loc="left")
    axes.grid(color="#eeeeee")
    axes.legend(loc="lower right", frameon=False, fontsize=8)


def _by_data(found: Pareto) -> dict[str, list[Point]]:
    names = dict.fromkeys(point.data for point in found.points)
    return {name: [point for point in found.points if point.data == name] for name in names}


def _cell(value: float | int | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
