"""Pictures of a run: what the cameras saw, what the twin made of it, what it foresaw, and curves over time."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from twin_node.forecast.score import projected
from twin_node.nodes.overlays import tinted
from twin_node.nodes.report.quality import Image
from twin_node.scene import Bool, Camera, Grid, Separation, Tier, UInt8, UInt32

TIER_COLOURS = ("#9aa0a6", "#188038", "#1a73e8", "#4a148c", "#f29900")
FORESEEN = (66, 133, 244)
TRUE = (52, 168, 83)
MASK = (255, 0, 255)
"""Colours drawn into images, RGB. With less blue the last is the grey of a floor to who sees no green."""
ENLARGED_TO = 480
"""Small images are shown larger, by the whole factor that brings their longer side nearest to this, pixels."""
GAP_S, GAP_STEPS = 1.0, 4.0
"""Nothing is drawn between two sets that are farther apart than both: this, and so many of their usual steps."""

mpl.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True})
mpl.rcParams.update({"grid.color": "#e8eaed", "figure.facecolor": "white", "legend.frameon": False})


@dataclass(frozen=True)
class Curve:
    """A quantity over time."""

    label: str
    seconds: NDArray[np.float64]
    values: NDArray[np.float64]


def camera_column(image: Image, rendering: Image, moving: Bool | None) -> tuple[UInt8, UInt8, UInt8]:
    """Image, rendering, and the image with the moving mask outlined, RGB."""
    outlined = enlarge(image)
    if moving is not None:
        outlined = outline(outlined, moving, MASK)
    return enlarge(image), enlarge(rendering), outlined


def table(columns: Sequence[Sequence[UInt8]]) -> UInt8:
    """Columns of pictures side by side on white; those of a row have their tops in line."""
    return np.vstack([_beside(row) for row in zip(*columns, strict=True)])


def _beside(pictures: Sequence[UInt8]) -> UInt8:
    height = max(picture.shape[0] for picture in pictures)
    padded = [np.pad(p, ((0, height - p.shape[0]), (0, 6), (0, 0)), constant_values=255) for p in pictures]
    return np.hstack(padded)[:, :-6]


def forecast_picture(image: Image, camera: Camera, grid: Grid, foreseen: UInt32, true: UInt32) -> UInt8:
    """An image with the space foreseen for its time (blue) and the space seen to move then (green), RGB."""
    picture = fill(enlarge(image), projected(camera, grid, foreseen), FORESEEN)
    return outline(picture, projected(camera, grid, true), TRUE)


def enlarge(image: Image) -> UInt8:
    """[h, w, 3] the image in 8 bits, larger where it is much smaller than `ENLARGED_TO`."""
    pixels = (np.clip(image, 0, 1) * 255).astype(np.uint8)
    factor = max(1, round(ENLARGED_TO / max(image.shape[1], image.shape[0])))
    size = (image.shape[1] * factor, image.shape[0] * factor)
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)


def outline(picture: UInt8, mask: Bool, colour: tuple[int, int, int]) -> UInt8:
    """The picture with the contours of a mask drawn, those of its holes too."""
    drawn = picture.copy()
    contours, _ = cv2.findContours(_enlarged(mask, picture), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    cv2.drawContours(drawn, contours, -1, colour, 2)
    return drawn


def fill(picture: UInt8, mask: Bool, colour: tuple[int, int, int]) -> UInt8:
    """The picture with a mask tinted."""
    return tinted(picture, _enlarged(mask, picture) > 0, colour)


def _enlarged(mask: Bool, picture: UInt8) -> UInt8:
    """A mask, 0 and 1, in the pixels of a picture."""
    size = (picture.shape[1], picture.shape[0])
    return np.asarray(cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST), np.uint8)


def png(picture: UInt8) -> bytes:
    """PNG of an RGB picture."""
    return cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))[1].tobytes()


def curves(title: str, unit: str, series: Sequence[Curve]) -> bytes:
    """PNG of quantities, none of them negative, over the log's time."""
    figure = Figure(figsize=(7.2, 2.6), dpi=110, layout="constrained")
    axes = figure.subplots()
    for curve in series:
        axes.plot(*_broken(curve.seconds, curve.values), label=curve.label, linewidth=1.2)
    axes.set(title=title, xlabel="time, s", ylabel=unit)
    axes.set_ylim(bottom=0)
    return _png_of(figure, len(series) if len(series) > 1 else 0)


def tiers_over_time(seconds: NDArray[np.float64], counts: NDArray[np.float64]) -> bytes:
    """PNG of the Gaussians per tier [T, 5] over time [T], on a logarithmic scale."""
    figure = Figure(figsize=(7.2, 2.6), dpi=110, layout="constrained")
    axes = figure.subplots()
    for tier in Tier:
        if counts[:, tier].any():
            axes.plot(*_broken(seconds, counts[:, tier]), label=tier.name, color=TIER_COLOURS[tier], linewidth=1.4)
    axes.set(title="Gaussians per tier", xlabel="time, s", yscale="symlog")
    axes.set_ylim(bottom=0)
    return _png_of(figure, len(Tier))


def separation_over_time(seconds: NDArray[np.float64], separations: Sequence[Separation]) -> bytes:
    """PNG of the smallest distance, the one that is required of what falls most short, and the speed that is left."""
    figure = Figure(figsize=(7.2, 3.4), dpi=110, layout="constrained")
    upper, lower = figure.subplots(2, sharex=True)
    distances = np.array([s.distance for s in separations])
    near = np.where(np.isfinite(distances), distances, np.nan)
    upper.plot(*_broken(seconds, near), color="#1a73e8", label="nearest")
    required = np.array([s.required for s in separations])
    label = "required at full speed, of what falls most short"
    upper.plot(*_broken(seconds, required), color="#d93025", linewidth=1, label=label)
    upper.axhline(0, color="#202124", linewidth=0.8)
    upper.set(title="Smallest distance along the arm's next 200 ms", ylabel="m")
    speeds = _broken(seconds, np.array([s.speed_fraction for s in separations]))
    lower.fill_between(*speeds, color="#34a853", alpha=0.5, step="post")
    lower.set(ylabel="speed fraction", xlabel="time, s", ylim=(0, 1.05))
    return _png_of(figure, 2)


def _broken(seconds: NDArray[np.float64], values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Times [T] and values [T] of a curve, NaN one step into every pause: what was not measured is not drawn."""
    steps = np.diff(seconds)
    usual = float(np.median(steps)) if len(steps) else 0.0
    after = np.flatnonzero(steps > max(GAP_S, GAP_STEPS * usual)) + 1
    ends = seconds[after - 1] + usual
    return [np.insert(seconds, after, ends), np.insert(values.astype(np.float64), after, np.nan)]


def _png_of(figure: Figure, names: int) -> bytes:
    """The figure; below it, where no curve runs, up to so many names of its curves beside each other."""
    if names:
        figure.legend(ncols=names, loc="outside lower center")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
