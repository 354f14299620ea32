"""Speed against accuracy as tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from twin_node.bench.pareto.front import dominated_sizes, on_front
from twin_node.bench.pareto.hexplane import against_hexplane, said
from twin_node.bench.pareto.measure import OURS, Point
from twin_node.bench.pareto.suite import Pareto
from twin_node.bench.text_table import figure, markdown_table, text_table
from twin_node.nodes.sizes import SIZES

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


def text(found: Pareto) -> str:
    """The tables as lines."""
    lines = []
    for data, points in found.by_data().items():
        rows = []
        for point in points:
            marks = f"{' *' if point.online else ''}{' =' if on_front(point, found.points) else ''}"
            rows.append((point.title + marks, *_cells(point)))
        lines += [f"{data} (* online, = on the front; times of one core)", text_table(("", *COLUMNS), rows)]
    return "\n".join([*lines, *_verdicts(found)])


def markdown(found: Pareto) -> str:
    """The tables as Markdown."""
    lines = []
    for data, points in found.by_data().items():
        rows = []
        for point in points:
            title = point.title + (" \\*" if point.online else "")
            title = f"**{title}**" if on_front(point, found.points) else title
            rows.append((title, *_cells(point)))
        heads = ("method (\\* online, **on the front**)", *COLUMNS)
        lines += [f"### {data}", "", markdown_table(heads, rows), ""]
    return "\n".join([*lines, *(f"- {verdict}" for verdict in _verdicts(found))]) + "\n"


def front_text(points: Sequence[Point]) -> str:
    """What `nodes.size_choice.read_front` reads, of measured points."""
    lines = ["# Sizes of the live model, as measured; made by `twin_node bench pareto`.", "sizes:"]
    for name in SIZES:
        own = [p for p in points if p.name == f"{OURS}_{name}" and p.psnr_left_out_db is not None]
        if own:
            ms = float(np.mean([p.ms_per_frame for p in own]))
            db = float(np.mean([p.psnr_left_out_db or 0.0 for p in own]))
            lines.append(f"  - {{name: {name}, ms_per_frame: {ms:.1f}, psnr_left_out_db: {db:.2f}}}")
    return "\n".join(lines) + "\n"


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


def _cells(point: Point) -> Iterator[str]:
    return (figure(value(point)) for value in COLUMNS.values())
