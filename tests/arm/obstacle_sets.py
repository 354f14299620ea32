"""Obstacles for tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_node.scene import ObstacleKind, Obstacles, ObstacleShape

NOW = 1_700_000_000_000_000_000
MS = 1_000_000


@dataclass(frozen=True)
class Thing:
    """One obstacle; times are ms after `NOW`."""

    position: tuple[float, float, float]
    size: tuple[float, float, float] = (0.2, 0.2, 0.2)
    kind: ObstacleKind = ObstacleKind.MOVING
    shape: ObstacleShape = ObstacleShape.SPHERE
    quat: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    valid_ms: tuple[int, int] = (0, 200)
    reach: tuple[float, float] = (0.0, 0.0)
    """Speed, m/s, and delay, s."""


def obstacles(*things: Thing, first_id: int = 100, stamp: int = NOW) -> Obstacles:
    """The things as a set, numbered from `first_id`."""
    count = len(things)

    def column(values: Sequence[object], width: int) -> np.ndarray:
        return np.array(values, dtype=np.float64).reshape(count, width)

    return Obstacles(
        stamp=stamp,
        ids=np.arange(first_id, first_id + count, dtype=np.uint32),
        kinds=np.array([thing.kind for thing in things], dtype=np.uint8),
        shapes=np.array([thing.shape for thing in things], dtype=np.uint8),
        positions=column([thing.position for thing in things], 3),
        quats=column([thing.quat for thing in things], 4),
        sizes=column([thing.size for thing in things], 3),
        velocities=column([thing.velocity for thing in things], 3),
        bounds=np.zeros(count),
        valid_from=np.array([NOW + thing.valid_ms[0] * MS for thing in things], dtype=np.int64),
        valid_to=np.array([NOW + thing.valid_ms[1] * MS for thing in things], dtype=np.int64),
        reach_speeds=np.array([thing.reach[0] for thing in things], dtype=np.float64),
        reach_delays=np.array([thing.reach[1] for thing in things], dtype=np.float64),
    )


def random_obstacles(count: int, seed: int, spread: float = 1.2) -> Obstacles:
    """Spheres and turned boxes of 3 to 25 cm about the arm."""
    generator = np.random.default_rng(seed)
    things = []
    for _ in range(count):
        box = generator.random() < 0.5
        edge = generator.uniform(0.03, 0.25, 3)
        things.append(
            Thing(
                position=tuple(generator.uniform(-spread, spread, 3)),
                size=tuple(edge) if box else (edge[0],) * 3,
                shape=ObstacleShape.BOX if box else ObstacleShape.SPHERE,
                quat=tuple(generator.normal(size=4)),
            )
        )
    return obstacles(*things)
