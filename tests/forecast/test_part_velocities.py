"""Velocities of parts from the images: small things that fly far between two of them."""

from __future__ import annotations

import numpy as np
import pytest
from forecast_worlds import GRID, RIG, ball_voxels, state_of

from twin_node.forecast.parts import PartVelocities, split
from twin_node.forecast.tables import RigTables

PERIOD_S = 1 / 30


@pytest.mark.parametrize("speed", [0.5, 3.0, 6.0])
def test_a_ball_is_as_fast_as_it_flies(speed: float) -> None:
    """At 6 m/s it flies 20 cm, nearly its width, between two images."""
    direction = np.array([0.6, 0.64, -0.48])
    velocities = PartVelocities(RigTables(GRID))
    mean = np.zeros(3)
    for number in range(5):
        center = np.array([-0.2, -0.2, 0.55]) + number * PERIOD_S * speed * direction
        state = state_of(round(number * PERIOD_S * 1e9), center, radius=0.11, cameras=RIG)
        voxels = ball_voxels(center, 0.11)
        parts = split(GRID, voxels, np.ones(len(voxels), np.bool_))
        mean = velocities.update(state, parts, np.tile(mean, (parts.count, 1))).mean(axis=0)
    assert np.linalg.norm(mean - speed * direction) < 0.35 * speed
