"""Speed against accuracy as tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from twin_node.bench.pareto.front import dominated_sizes, on_front
from twin_node.bench.pareto.hexplane import against_hexplane, said
from twin_node.bench.pareto.measure import OURS, Point
from twin_node.bench.pareto.suite import Pareto
from twin_node.bench.results_folder import markdown_table
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
    for data, points in found.by_data().items():
        rows = []
        for point in points:
            title = point.title + (" \\*" if point.online else "")
            title = f"**{title}**" if on_front(point, found.points) else title
            rows.append((title, *(_cell(value(point)) for value in COLUMNS.values())))
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


def _cell(value: float | int | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
