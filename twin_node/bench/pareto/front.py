"""Which methods nobody beats in speed and quality at once, and which beat ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from twin_node.bench.pareto.measure import OURS, Point
from twin_node.scene import Float64

Quality = Callable[[Point], "Float64 | None"]
"""Figures [n] of which more is better; None where a method does not have them."""


def pictures(point: Point) -> Float64 | None:
    """[2] moving pixels of cameras that were not learnt from, dB, and speed."""
    return None if point.psnr_left_out_db is None else np.array([point.psnr_left_out_db, -point.ms_per_frame])


def forecasts(point: Point) -> Float64 | None:
    """[3] share of what is occupied in 200 ms that was foreseen, space left free, and speed of the forecast."""
    if point.recall is None or point.volume_l is None or point.forecast_ms is None:
        return None
    return np.array([point.recall, -point.volume_l, -point.forecast_ms])


QUALITIES: tuple[Quality, ...] = (pictures, forecasts)


def dominates(one: Point, other: Point, quality: Quality) -> bool:
    """Whether a method is as good as another on the same data in all figures, and better in one."""
    mine, theirs = quality(one), quality(other)
    if mine is None or theirs is None or one.data != other.data:
        return False
    return bool((mine >= theirs).all() and (mine > theirs).any())


def on_front(point: Point, points: Sequence[Point]) -> bool:
    """Whether in some quality that it has no online method on its data dominates it."""
    return any(
        quality(point) is not None and not any(dominates(one, point, quality) for one in points if one.online)
        for quality in QUALITIES
    )


def dominated_sizes(point: Point, points: Sequence[Point]) -> tuple[str, ...]:
    """Names of our sizes that a method which is online and not ours dominates."""
    if not point.online or is_ours(point):
        return ()
    ours = (other for other in points if is_ours(other))
    return tuple(other.name for other in ours if any(dominates(point, other, quality) for quality in QUALITIES))


def is_ours(point: Point) -> bool:
    """Whether it is the live model, of any size."""
    return point.name.split("_")[0] == OURS
