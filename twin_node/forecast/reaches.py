"""How far nodes may be from where they are led: what is calibrated, what they can reach, and how far people get."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast import measured
from twin_node.forecast.bound import LARGEST_RADIUS, PERSON_SPEED, Bound, Expected
from twin_node.forecast.kernels import Kernels, kernels
from twin_node.forecast.measured import Measured
from twin_node.forecast.part_requests import ReachRequest
from twin_node.native_library import addresses_of
from twin_node.scene import Float64


@dataclass(frozen=True)
class Known:
    """What the bounds of M nodes come of."""

    now: float
    """s."""
    horizon_s: float
    """How far ahead they are forecast; who has been known for less is new."""
    expected: Expected
    """Their errors."""
    born: Float64
    """[M] s when each was first known."""
    began: Float64
    """[M] s when it began something new."""
    turned: Float64
    """[M] s when it last turned back; -inf if never."""
    speeds: Float64
    """[M] m/s."""
    measured: Measured | None
    """What is known of these velocities, if they are measured."""
    stale_s: float = 0.0
    """How long ago they were these, s (`staleness`)."""


@dataclass(frozen=True)
class Span:
    """The times that bounds are asked for."""

    horizons: Float64
    """[H] s from now, rising."""
    shares: Float64
    """[H] of the calibrated radius at the last of them."""
    capped: bool
    """No radius about a measured velocity exceeds how far people get from it (`Measured.most`)."""


def staleness(times: Float64) -> float:
    """How long ago (s) velocities were those that show between the last two of `times` [T] (s), as far as it counts.

    They are those of the middle between these. Up to `_SOON_S` the reach without it suffices: at ten sets per second
    and more it held all of a ball that swings with accelerations as foreseen, at five 93 to 97 %, 68 % at worst.
    """
    step = float(times[-1] - times[-2]) if len(times) > 1 else 0.0
    return float(np.clip(step - _SOON_S, 0, step / 2))


_SOON_S = 0.11
"""Ten sets per second, and their jitter, s."""


def reaches(known: Known, bound: Bound, factor: float, span: Span) -> Float64:
    """[H, M] radii (m) about where the nodes are led; `factor` multiplies what is calibrated.

    Compiled; `reaches_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return reaches_reference(known, bound, factor, span)
    return _reaches_by(compiled, known, bound, factor, span)


def _reaches_by(compiled: Kernels, known: Known, bound: Bound, factor: float, span: Span) -> Float64:
    horizons, told, last = span.horizons, known.measured, float(span.horizons[-1])
    radii = np.empty((len(horizons), len(known.born)))
    starts, reached = measured.start_radii(horizons), _reachable(known, bound, horizons)
    by_time = (horizons, span.shares, np.sqrt(horizons / last), horizons**1.5, starts, reached)
    by_node = (*known.expected, known.born, known.began, known.turned, known.speeds)
    kinds = (None,) * 4 if told is None else (told.flying, told.alone, told.falling, told.clear_s)
    velocities = (None if told is None else told.sigmas, *kinds)
    given = [None if array is None else np.ascontiguousarray(array) for array in (*by_time, *by_node, *velocities)]
    sizes = (radii.shape[1], len(horizons), span.capped)
    times = (known.now, last, known.horizon_s, WARY * last)
    lengths = (factor * bound.quantile, bound.reachable(last, known.stale_s), LARGEST_RADIUS)
    compiled.run(
        ReachRequest(
            *(*sizes, *times, *lengths, PERSON_SPEED, measured.fallen(last), measured.PLACE, *measured.RATES),
            *addresses_of(*given, radii),
        )
    )
    return radii


def reaches_reference(known: Known, bound: Bound, factor: float, span: Span) -> Float64:
    """What `reaches` does."""
    horizons, told, last = span.horizons, known.measured, float(span.horizons[-1])
    ages, largest = known.now - known.began, LARGEST_RADIUS
    reachable = bound.reachable(last, known.stale_s)
    radii = bound.radii(known.expected, ages, last, factor, known.stale_s)
    wary = known.now - known.turned < WARY * last
    radii = np.where(wary, np.maximum(radii, reachable), radii)
    if told is None:
        return np.asarray(span.shares[:, None] * np.minimum(radii, largest))
    reach = told.reach(known.expected.spread, known.speeds, reachable, last)
    radii = np.where(told.newcomers(known.now - known.born, ages, known.horizon_s), reach, radii)
    within = told.sooner(horizons / last, span.shares) * np.minimum(radii, largest)
    within = np.minimum(within, told.in_flight(horizons, _reachable(known, bound, horizons)))
    if span.capped:
        within = np.minimum(within, told.most(known.speeds, horizons))
    return np.maximum(within, np.minimum(told.start(horizons), largest))


def _reachable(known: Known, bound: Bound, horizons: Float64) -> Float64:
    """[H] how far the largest acceleration takes a node by then, m."""
    return np.array([bound.reachable(horizon, known.stale_s) for horizon in horizons.tolist()])


WARY = 2.0
"""What has turned back may do other things as well: for so many horizons it is bounded by what it can reach too."""
