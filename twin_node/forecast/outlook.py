"""What experts make of the nodes of one sample: how they are weighed, where they lead, and how far that may err."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.bound import CUES, LEAST, CueLengths, cues
from twin_node.forecast.experts import (
    BOUNCE,
    EXPERT_NAMES,
    FEATURES,
    FILLED,
    GRAVITY,
    INDIFFERENCE,
    LAG_S,
    LAGS,
    LINE_S,
    PARABOLA_S,
    SHARPNESS,
    History,
    autoregression_features,
    damped_times,
    mix,
)
from twin_node.forecast.kernels import Kernels, kernels
from twin_node.forecast.leading import Guides, Led, led_reference
from twin_node.forecast.neighbours import BODY_SCALE, CELL, NEAR_SCALE, Closest, Neighbours, closest
from twin_node.forecast.part_requests import OutlookRequest
from twin_node.forecast.records import Rows
from twin_node.native_library import addresses_of
from twin_node.scene import Float64

_POOLED = 0.5
"""Share of the neighbours in the record that experts are weighed by."""


@dataclass(frozen=True)
class Standing:
    """What the experts are weighed by, for M nodes."""

    squared: Float64
    """[E, M] recent mean square errors of each, m^2."""
    errors: Float64
    """[M] recent error of their mixture, m."""
    trust: Float64
    """[E] in each, whatever the node."""
    alone: Rows
    """[M] the expert that leads a node alone, by its place in `EXPERT_NAMES`; -1 for none."""


@dataclass(frozen=True)
class Outlook:
    """What they make of them."""

    features: Float64
    """[M, 3, F] of the autoregression."""
    shares: Float64
    """[E, M] weights by the records."""
    led: Led
    """Where they lead in H horizons."""
    cues: Float64
    """[M, C] of the error at the last horizon."""


def outlook(
    history: History,
    standing: Standing,
    floors: Float64,
    learnt: Float64,
    horizons: Float64,
    near: Closest | None = None,
) -> Outlook:
    """Where the nodes that a history ends with are led in `horizons` [H] (s).

    `floors` [M]: heights in metres that they bounce from. `learnt` [H, F]: weights of the autoregression's features.
    `near`: what `closest` says of where the nodes are, if that is known. Compiled; `outlook_reference` where that
    cannot be.
    """
    compiled, near = kernels(), closest(history.positions[-1]) if near is None else near
    if compiled is None:
        return outlook_reference(history, standing, floors, learnt, horizons, near)
    return _outlook_by(compiled, history, standing, floors, learnt, horizons, near)


def _outlook_by(
    compiled: Kernels,
    history: History,
    standing: Standing,
    floors: Float64,
    learnt: Float64,
    horizons: Float64,
    near: Closest,
) -> Outlook:
    (samples, count, _), experts, ahead = history.positions.shape, len(EXPERT_NAMES), len(horizons)
    single, mixed = np.empty((experts, ahead, count, 3)), np.empty((ahead, count, 3))
    found = Outlook(
        np.empty((count, 3, FEATURES)), np.empty((experts, count)), Led(single, mixed), np.empty((count, CUES))
    )
    fits = (np.empty((1, count, 3)), np.empty((2, count, 3)), np.empty((count, 3)))
    lengths = (history.times, history.positions, near.distances, standing.squared, standing.errors, standing.trust)
    led_by = (floors, learnt, horizons, damped_times(horizons), GRAVITY)
    given = [np.ascontiguousarray(array, np.float64) for array in (*lengths, *led_by)]
    rows = [np.ascontiguousarray(array, np.int64) for array in (near.rows, standing.alone)]
    compiled.run(
        OutlookRequest(
            *(count, samples, near.rows.shape[1], ahead, LAGS, FEATURES),
            *(LINE_S, PARABOLA_S, FILLED, LAG_S, NEAR_SCALE, BODY_SCALE, CELL),
            *(_POOLED, SHARPNESS, INDIFFERENCE, BOUNCE, LEAST),
            *addresses_of(*given[:3], rows[0], *given[3:6], rows[1], *given[6:], *fits),
            *addresses_of(found.features, found.shares, single, mixed, found.cues),
        )
    )
    history.take_fits(*fits)
    return found


def outlook_reference(
    history: History,
    standing: Standing,
    floors: Float64,
    learnt: Float64,
    horizons: Float64,
    near: Closest | None = None,
) -> Outlook:
    """What `outlook` does."""
    around = Neighbours(history.positions[-1], near)
    features = autoregression_features(history, around)
    pooled = around.body(standing.squared.T).T
    shares = mix((1 - _POOLED) * standing.squared + _POOLED * pooled)
    weights = weighed(shares, standing.trust, standing.alone)
    found = led_reference(Guides(history, features, floors), learnt, weights, horizons)
    return Outlook(features, shares, found, _cues_of(found.single[:, -1], found.mixed[-1], standing.errors, around))


def weighed(shares: Float64, trust: Float64, alone: Rows) -> Float64:
    """Weights [E, M] of experts by their `shares` [E, M] and the `trust` [E] in each.

    `alone` [M]: the one that leads a node alone; -1 for none.
    """
    trusted = shares * trust[:, None]
    only = (np.arange(len(shares))[:, None] == alone).astype(np.float64)
    weights: Float64 = np.where(alone < 0, trusted / trusted.sum(axis=0), only)
    return weights


def _cues_of(single: Float64, mixed: Float64, errors: Float64, around: Neighbours) -> Float64:
    """Cues [M, C] from the experts' displacements [E, M, 3], the mixture's [M, 3] and recent errors [M]."""
    by_will = single[: EXPERT_NAMES.index("free_fall")]  # what falls is as far from all others whatever they err by
    apart = np.sort(np.linalg.norm(by_will - mixed, axis=-1), axis=0)
    spread = apart[len(by_will) // 2]  # of five: the third is the median
    by_name = dict(zip(EXPERT_NAMES, single, strict=True))
    way = np.linalg.norm(by_name["constant_velocity"], axis=-1)
    acceleration = np.linalg.norm(by_name["constant_acceleration"] - by_name["constant_velocity"], axis=-1)
    squares = np.stack([way, acceleration, errors], axis=1) ** 2
    body_way, body_acceleration, body_error = np.sqrt(around.body(squares)).T
    return cues(CueLengths(spread, way, acceleration, body_way, body_acceleration, body_error))
