"""Draws what `bench masks` found under its first seed: images with what their masks made of them, and all over time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from twin_node.bench.mask_scores import MaskTally
from twin_node.bench.masks import MasksBench, Shot
from twin_node.bench.results_folder import save_chart
from twin_node.scene import UInt8

if TYPE_CHECKING:
    from matplotlib.axes import Axes

UNMOVED = ("missed_rested", "missed_waiting")
COLOURS = {"right": "#2a6f97", **dict.fromkeys(UNMOVED, "#e9c46a"), "missed": "#c8553d", "false": "#b5179e"}
"""Of `PixelKinds`."""
COVER = 0.65
"""Share of its kind's colour in what a pixel looks like."""


def draw(found: MasksBench, folder: Path, name: str) -> Path:
    """Writes NAME.png and NAME.svg into a folder, which is made where it is missing; gives the former's path.

    Raises `BenchError` where the folder cannot be written.
    """
    first, start_ns = found.runs[0], found.scenario.start_ns
    cameras, columns = list(first.tallies), max(len(first.moments), 1)
    figure = Figure(figsize=(2.8 * columns + 0.4, 2.2 * len(cameras) + 2.8), layout="constrained")
    grid = figure.add_gridspec(len(cameras) + 1, columns)
    curves = figure.add_subplot(grid[-1, :])
    _draw_curves(curves, first.tallies.values(), start_ns)
    for column, shots in enumerate(first.moments):
        for shot in shots:
            _draw_shot(figure.add_subplot(grid[cameras.index(shot.camera), column]), shot, start_ns)
        curves.axvline((shots[0].stamp - start_ns) * 1e-9, color="black", linewidth=0.8, linestyle=":")
    patches = [Patch(color=COLOURS["right"], label="marked and can move"), Patch(color=COLOURS["false"], label="false")]
    patches.append(Patch(color=COLOURS["missed"], label="missed"))
    patches.append(Patch(color=COLOURS[UNMOVED[0]], label="missed, but has come to rest or is yet to move"))
    figure.suptitle(f"{found.scenario.name}, seed {first.seed}", x=0.01, ha="left", fontsize=10)
    figure.legend(handles=patches, loc="outside upper center", ncols=len(patches), frameon=False)
    return save_chart(figure, folder, name)


def _draw_shot(axes: Axes, shot: Shot, start_ns: int) -> None:
    axes.imshow(_tinted(shot), interpolation="nearest")
    axes.set_title(f"{shot.camera}, {(shot.stamp - start_ns) * 1e-9:.1f} s", loc="left", fontsize=9)
    axes.set_axis_off()


def _draw_curves(axes: Axes, tallies: Iterable[MaskTally], start_ns: int) -> None:
    """Pixels of each kind per image, mean over the cameras."""
    known = [tally for tally in tallies if tally.images]
    seconds = [[(image.stamp - start_ns) * 1e-9 for image in tally.images] for tally in known]
    for kinds in (("missed",), UNMOVED, ("false",)):
        pixels = [[sum(getattr(image, kind) for kind in kinds) for image in tally.images] for tally in known]
        means = [np.interp(seconds[0], *curve) for curve in zip(seconds, pixels, strict=True)]
        if means:
            axes.plot(seconds[0], np.mean(means, axis=0), color=COLOURS[kinds[0]])
    axes.set_ylim(bottom=0)
    axes.margins(x=0)
    axes.set_xlabel("s")
    axes.set_ylabel("pixels per image")


def _tinted(shot: Shot) -> UInt8:
    """Its image, grey where no kind of pixel is coloured."""
    grey = shot.rgb.mean(-1, keepdims=True).repeat(3, -1)
    for kind, colour in COLOURS.items():
        chosen = getattr(shot.kinds, kind)
        grey[chosen] = (1 - COVER) * grey[chosen] + COVER * 255 * np.array(to_rgb(colour))
    tinted: UInt8 = grey.astype(np.uint8)
    return tinted
