"""The table of methods as lines to read and as a chart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from twin_node.bench.methods.table import MethodRow, MethodsBench
from twin_node.bench.results_folder import save_chart
from twin_node.bench.text_table import figure, text_table

COLUMNS: dict[str, Callable[[MethodRow], float | int | None]] = {
    "PSNR": lambda row: row.scores.psnr_db,
    "moving": lambda row: row.scores.psnr_moving_db,
    "unchanged": lambda row: row.scores.psnr_unchanged_db,
    "SSIM": lambda row: row.scores.ssim,
    "learn ms/frame": lambda row: row.learn_ms_per_frame,
    "draw ms": lambda row: row.scores.draw_ms,
    "MB": lambda row: None if row.bytes is None else row.bytes / 1e6,
    "parameters": lambda row: row.parameters,
    "track mm": lambda row: row.track_mm.get("all"),
}
"""Heading -> what stands below it."""


def text(bench: MethodsBench) -> str:
    """The table as lines, and the figures below it."""
    rows = (
        (f"{row.title}{' *' if row.online else ''}", *(figure(value(row)) for value in COLUMNS.values()))
        for row in bench.rows.values()
    )
    lines = [
        f"{bench.data}: {bench.frames} frames of {bench.size}, {bench.training_images} training images, "
        f"scored on {bench.scored_images} held-out images (PSNR in dB)",
        text_table(("", *COLUMNS), rows),
        "* knows the images up to each time alone",
    ]
    if bench.ours_less_offline_db is not None:
        lines.append(f"ours less the better 4DGS, moving pixels: {bench.ours_less_offline_db:+.2f} dB")
    lines += [f"{name}: {value:.2f}" for name, value in bench.ablations.items()]
    return "\n".join(lines)


def draw_chart(bench: MethodsBench, folder: Path) -> Path:
    """`methods.png` in `folder`: PSNR of all and of moving pixels. Raises `BenchError` where it cannot be written."""
    from matplotlib.figure import Figure

    chart = Figure(figsize=(8, 0.5 * len(bench.rows) + 1.8), layout="constrained")
    axes = chart.add_subplot()
    titles = [row.title for row in bench.rows.values()]
    for offset, name in ((-0.2, "PSNR"), (0.2, "moving")):
        found = [COLUMNS[name](row) for row in bench.rows.values()]
        label = "all pixels" if name == "PSNR" else "moving pixels"
        lengths = [value or 0.0 for value in found]
        bars = axes.barh([index + offset for index in range(len(titles))], lengths, 0.38, label=label)
        told = ["" if value is None else f"{value:.1f}" for value in found]
        axes.bar_label(bars, told, padding=2, fontsize=8)
    axes.set_yticks(range(len(titles)), titles)
    axes.invert_yaxis()
    axes.set_axisbelow(True)
    axes.set_xlabel("PSNR on held-out cameras, dB")
    chart.legend(loc="outside lower center", ncols=2, frameon=False)
    axes.set_title(f"{bench.data}, {bench.frames} frames of {bench.size}")
    return save_chart(chart, folder, "methods")
