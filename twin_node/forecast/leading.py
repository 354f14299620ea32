"""Where all experts lead nodes, each alone and all together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.experts import BOUNCE, EXPERT_NAMES, EXPERTS, GRAVITY, History, damped_times, free_fall
from twin_node.forecast.kernels import Kernels, kernels
from twin_node.forecast.part_requests import LeadRequest
from twin_node.native_library import addresses_of
from twin_node.scene import Float64


@dataclass(frozen=True)
class Guides:
    """What the experts go by, for M nodes."""

    history: History
    features: Float64
    """[M, 3, F] of the autoregression."""
    floors: Float64
    """[M] m, heights that things bounce from."""


@dataclass(frozen=True)
class Led:
    """Displacements after H horizons, m."""

    single: Float64
    """[E, H, M, 3] by each expert alone."""
    mixed: Float64
    """[H, M, 3] by all together."""


def led(guides: Guides, learnt: Float64, weights: Float64, horizons: Float64) -> Led:
    """Where experts with `weights` [E, M] lead nodes in `horizons` [H] (s).

    `learnt` [H, F]: weights of the autoregression's features. Compiled; `led_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return led_reference(guides, learnt, weights, horizons)
    return _led_by(compiled, guides, learnt, weights, horizons)


def _led_by(compiled: Kernels, guides: Guides, learnt: Float64, weights: Float64, horizons: Float64) -> Led:
    history, (count, _, features) = guides.history, guides.features.shape
    found = Led(np.empty((len(EXPERT_NAMES), len(horizons), count, 3)), np.empty((len(horizons), count, 3)))
    paths = (history.positions[-1], history.line, history.parabola, history.falling)
    given = (*paths, guides.floors, guides.features, learnt, weights, horizons, damped_times(horizons), GRAVITY)
    arrays = [*(np.ascontiguousarray(array, np.float64) for array in given), found.single, found.mixed]
    sizes = (count, len(horizons), features, BOUNCE)
    compiled.run(LeadRequest(*sizes, *addresses_of(*arrays)))
    return found


def led_reference(guides: Guides, learnt: Float64, weights: Float64, horizons: Float64) -> Led:
    """What `led` does."""
    plain = [expert(guides.history, horizons) for expert in EXPERTS]
    remembered = np.einsum("hf,mcf->hmc", learnt, guides.features)
    single = np.stack([*plain, remembered, free_fall(guides.history, horizons, guides.floors)])
    return Led(single, np.einsum("em,ehmc->hmc", weights, single))
