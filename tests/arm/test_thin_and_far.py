"""Obstacles without thickness, and such as are far away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from obstacle_sets import Thing, obstacles

from twin_node.arm import ArmCollisionChecker
from twin_node.scene import ObstacleShape

READY = np.array([0.3, -1.2, 1.4, -1.7, -1.57, 0.2])


@pytest.mark.parametrize(
    "size", [(0.5, 0.4, 0.0), (0.0, 0.4, 0.5), (0.4, 0.0, 0.0), (0.0, 0.0, 0.0)], ids=["plate", "wall", "bar", "point"]
)
@pytest.mark.parametrize("shape", ObstacleShape)
def test_what_has_no_thickness_is_as_far_as_what_hardly_has_any(
    ur5e_checker: ArmCollisionChecker, size: tuple[float, float, float], shape: ObstacleShape
) -> None:
    """An extent of 0 is endless to MuJoCo: a plate hung in the air would reach down to the arm."""
    size = size if shape is ObstacleShape.BOX else (size[1],) * 3
    flat = obstacles(Thing((0.2, 0.9, 0.9), size, shape=shape, quat=(1.0, 0.2, -0.3, 0.1)))
    ur5e_checker.update(flat)
    found = ur5e_checker.distance(READY)
    ur5e_checker.update(replace(flat, sizes=np.maximum(flat.sizes, 1e-4)))
    hardly = ur5e_checker.distance(READY)
    assert (found.link, found.distance) == (hardly.link, pytest.approx(hardly.distance, abs=1e-4))
    np.testing.assert_allclose(found.on_arm, hardly.on_arm, atol=1e-3)
    np.testing.assert_allclose(found.on_obstacle, hardly.on_obstacle, atol=1e-3)


@pytest.mark.parametrize("shape", ObstacleShape)
@pytest.mark.parametrize("away_m", [900.0, 2e3, 1e6])
def test_what_is_far_away_is_so_far(ur5e_checker: ArmCollisionChecker, shape: ObstacleShape, away_m: float) -> None:
    ur5e_checker.update(obstacles(Thing((away_m, 0.0, 0.5), shape=shape)))
    found = ur5e_checker.distance(READY)
    assert found.distance == pytest.approx(away_m, abs=1.0)
    assert np.linalg.norm(found.on_arm) < 1.5
    assert found.on_obstacle[0] == pytest.approx(away_m, abs=0.2)
