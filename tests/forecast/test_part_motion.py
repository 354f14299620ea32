"""Which parts boxes hold: held against ways that are walked step by step."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.forecast import PartMotion
from twin_node.forecast.bound import PERSON_SPEED

STEPS = np.linspace(0, 1, 201)[:, None, None]


@pytest.mark.parametrize("interval", [None, 0, 2])
@pytest.mark.parametrize("seed", range(4))
def test_a_box_is_as_fast_as_the_fastest_that_passes_through_it_or_else_as_the_nearest(
    interval: int | None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    centers, displacements = rng.uniform(-1, 1, (40, 3)), rng.normal(0, 0.3, (5, 40, 3))
    displacements[:, :10, 1:] = 0  # along an axis, or nowhere
    displacements[:, :5] = 0
    velocities = rng.normal(0, 1.2, (40, 3))
    motion = PartMotion(centers, velocities, np.zeros((5, 40)), displacements=displacements)
    middles, halves = rng.uniform(-1.2, 1.2, (60, 3)), rng.uniform(0.1, 0.5, (60, 3))
    held = motion.held(interval, middles - halves, middles + halves)
    begin, end = (0, 0) if interval is None else (displacements[interval], displacements[interval + 1])
    ways = centers + begin + STEPS * (end - np.asarray(begin))
    speeds = np.linalg.norm(velocities, axis=1)
    assert (speeds > PERSON_SPEED).sum() > 10
    for row, (middle, half) in enumerate(zip(middles, halves, strict=True)):
        nearest = np.linalg.norm(ways[-1] - middle, axis=1).argmin()
        within = (np.abs(ways - middle) <= half).all(axis=2).any(axis=0) & (speeds > PERSON_SPEED)
        fastest = max([nearest, *np.flatnonzero(within)], key=lambda part: speeds[part])
        grazed = (np.abs(ways - middle) <= half + 0.01).all(axis=2).any(axis=0) & (speeds > PERSON_SPEED)
        assert held.nearest[row] == nearest
        assert held.fastest[row] == fastest or (grazed & ~within)[held.fastest[row]]  # between two steps


def test_nothing_moves_and_no_box_is_there() -> None:
    still = PartMotion(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((5, 1)))
    assert still.held(0, -np.ones((2, 3)), np.ones((2, 3))).fastest.tolist() == [0, 0]
    fast = PartMotion(np.zeros((1, 3)), np.full((1, 3), 9.0), np.zeros((5, 1)))
    assert len(fast.held(None, np.zeros((0, 3)), np.zeros((0, 3))).fastest) == 0
