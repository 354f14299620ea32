"""Boxes that stand are cut where regions of allowed contacts end: what is outside counts, however they are grouped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from obstacle_sets import Thing, obstacles, random_obstacles

from twin_node.arm import AllowedRegion, ArmCollisionChecker
from twin_node.arm.cutting import cut_at
from twin_node.robot import forward_kinematics, ur_model
from twin_node.scene import ObstacleKind, Obstacles, ObstacleShape

READY = np.array([0.0, -1.5, 1.5, -1.5, -1.57, 0.0])


def test_of_a_box_that_stands_what_is_outside_the_region_counts() -> None:
    tool = forward_kinematics(ur_model("ur5e"), READY)[-1, :3, 3]
    region = AllowedRegion(tool - 0.2, tool + 0.2, links=ur_model("ur5e").link_names)
    checker = ArmCollisionChecker("ur5e", max_obstacles=8, allowed=(region,))
    table = Thing(tuple(tool), size=(0.5, 0.6, 0.02), kind=ObstacleKind.STATIC, shape=ObstacleShape.BOX)
    checker.update(obstacles(table))
    rim = [
        Thing((tool[0] + side * 0.225, tool[1], tool[2]), size=(0.05, 0.6, 0.02), shape=ObstacleShape.BOX)
        for side in (-1, 1)
    ] + [
        Thing((tool[0], tool[1] + side * 0.25, tool[2]), size=(0.4, 0.1, 0.02), shape=ObstacleShape.BOX)
        for side in (-1, 1)
    ]
    alone = ArmCollisionChecker("ur5e", max_obstacles=8)
    alone.update(obstacles(*rim))
    found = checker.distance(READY)
    assert found.distance == pytest.approx(alone.distance(READY).distance, abs=1e-9)
    assert found.distance > 0
    assert found.obstacle_id == 100


@pytest.mark.parametrize("seed", range(20))
def test_pieces_take_up_the_space_of_their_box_and_end_where_regions_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given = random_obstacles(40, seed, spread=1.0)
    kinds = np.full(40, ObstacleKind.STATIC, np.uint8)
    along = np.tile([1.0, 0.0, 0.0, 0.0], (40, 1))
    given = replace(given, kinds=kinds, quats=along, sizes=3 * given.sizes)
    regions = tuple(AllowedRegion(rng.uniform(-0.6, -0.1, 3), rng.uniform(0.1, 0.6, 3)) for _ in range(2))
    pieces = cut_at(given, regions, most=10_000)
    points = rng.uniform(-1.5, 1.5, (20_000, 3))

    def holding(one: Obstacles) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
        held = np.abs(points[:, None] - one.positions) < one.sizes / 2
        return held.all(axis=2)

    boxes = given.shapes == ObstacleShape.BOX
    before, after = holding(given), holding(pieces)
    for row in np.flatnonzero(boxes):
        assert (after[:, pieces.ids == given.ids[row]].sum(axis=1) == before[:, row]).all()
    kept = pieces.shapes == ObstacleShape.BOX
    for region in regions:
        lower, upper = pieces.positions - pieces.sizes / 2, pieces.positions + pieces.sizes / 2
        inside = ((lower >= region.lower - 1e-6) & (upper <= region.upper + 1e-6)).all(axis=1)
        outside = ((lower >= region.upper - 1e-6) | (upper <= region.lower + 1e-6)).any(axis=1)
        assert (inside | outside)[kept].all()
    assert len(pieces.ids) > 40
    assert cut_at(given, regions, most=int(boxes.sum())) is given, "without room for the pieces all stay whole"
