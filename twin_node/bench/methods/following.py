"""Points carried along by the Gaussians next to them: one rule for all methods that have Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin_node.bench.methods.truth import Follow
from twin_node.model.sequence import SequenceModel
from twin_node.scene import Float64

CARRIERS = 4
"""Gaussians that carry a point."""
SOLID = 0.3
"""Opacity from which a Gaussian can carry a point."""


@dataclass(frozen=True)
class Population:
    """Gaussians of one time step."""

    ids: NDArray[np.int64]
    """[n] rising; the same number is the same Gaussian at every step."""
    means: Float64
    """[n, 3] m."""
    opacities: Float64
    """[n] 0 to 1."""


def follow_populations(steps: int, population: Callable[[int], Population]) -> Follow:
    """Points move by the mean motion of the `CARRIERS` Gaussians nearest to them when they were first seen.

    Where all of a point's carriers have died, the Gaussians nearest to where it then is take over.
    """

    def follow(points: Float64, begin: int) -> Float64:
        before = population(begin)
        carriers = _carriers(before, points)
        path = [points]
        for step in range(begin + 1, steps):
            now = population(step)
            old, new = _rows(before, carriers), _rows(now, carriers)
            alive = (old >= 0) & (new >= 0)
            moves = np.where(alive[..., None], now.means[new] - before.means[old], 0.0)
            path.append(path[-1] + moves.sum(1) / np.maximum(alive.sum(1), 1)[:, None])
            lost = ~(new >= 0).any(1)
            if lost.any():
                carriers[lost] = _carriers(now, path[-1][lost])
            before = now
        return np.stack(path)

    return follow


def follow_model(model: SequenceModel, stamps: Sequence[int]) -> Follow:
    """Points carried by the Gaussians of a sequence model."""
    opacities = model.gaussians.logits.detach().sigmoid().double().numpy()
    ids = np.arange(len(opacities))

    def population(step: int) -> Population:
        means = model.at([stamps[step]]).means[0].detach().double().numpy()
        return Population(ids, means, opacities)

    return follow_populations(len(stamps), population)


def stand_still(steps: int) -> Follow:
    """Points that stay where they were first seen."""
    return lambda points, begin: np.repeat(points[None], steps - begin, 0)


def no_motion(points: Float64, begin: int) -> None:
    """Of a method that knows no motion: images alone, or scenes without correspondence."""
    del points, begin


def _carriers(population: Population, points: Float64) -> NDArray[np.int64]:
    """[P, CARRIERS] ids of the nearest solid Gaussians; of any, where too few are solid."""
    solid = population.opacities >= SOLID
    chosen = np.flatnonzero(solid) if solid.sum() >= CARRIERS else np.arange(len(solid))
    count = min(CARRIERS, len(chosen))
    nearest = cKDTree(population.means[chosen]).query(points, k=count)[1].reshape(len(points), count)
    ids: NDArray[np.int64] = population.ids[chosen[nearest]]
    return ids


def _rows(population: Population, ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """[...] rows of ids; -1 where a Gaussian does not live."""
    rows = np.searchsorted(population.ids, ids).clip(max=len(population.ids) - 1)
    return np.where(population.ids[rows] == ids, rows, -1)
