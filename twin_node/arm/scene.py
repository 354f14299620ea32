"""The collision scene in MuJoCo: an arm of capsules and a fixed pool of spheres and boxes that stand for obstacles."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from twin_node.arm.errors import ArmError
from twin_node.robot import ArmModel
from twin_node.robot.mjcf import geom_names, write_mjcf
from twin_node.scene import Float64, Obstacles, ObstacleShape

_ARENA_BYTES_PER_OBSTACLE = 64 << 10
"""Memory for MuJoCo's broad phase and contacts: the default arena overflows at 2000 spheres, this never came near."""
_FAR_M = 1e7
"""Distances are measured up to here, m: farther than obstacles may be."""
_THIN_M = 1e-6
"""Half of the least extent of an obstacle in the scene, m: one of 0 is endless to MuJoCo, and points of smaller
ones come out as zeros."""
_COLOUR, _OPACITY = (0.9, 0.4, 0.1), 0.4
"""Of obstacles (sRGB, 0 to 1)."""


@lru_cache(maxsize=8)
def _compiled(mjcf: str, capacity: int) -> Any:
    """The model of an arm and its pool: nobody's to change, for MuJoCo takes 0.2 s to add a pool of 1024, and an arm
    that has set down what it carried is the one from before."""
    spec = mujoco.MjSpec.from_string(mjcf)
    spec.memory = max(32 << 20, capacity * _ARENA_BYTES_PER_OBSTACLE)
    for kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_BOX):
        for _ in range(capacity):
            body = spec.worldbody.add_body(mocap=True)
            body.add_geom(type=kind, size=[0.1, 0.1, 0.1], contype=0, conaffinity=1, rgba=[*_COLOUR, 0.0])
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE  # its boxes are those of compile time
    return model


@dataclass(frozen=True)
class Measured:
    """The shortest way between one capsule of the arm and one obstacle."""

    distance: float
    """m; negative: depth of penetration."""
    on_arm: Float64
    """[3] m, in `base_link`."""
    on_obstacle: Float64
    """[3] m, in `base_link`."""


class CollisionScene:
    """A MuJoCo model of the arm and of up to `capacity` spheres and as many boxes, moved as mocap bodies.

    Contact masks let the arm meet obstacles; obstacles never meet each other. The arm's own links are not paired here.
    `model` and `data` are MuJoCo's own, for viewers and for whoever steps the scene.
    """

    def __init__(self, model: ArmModel, capacity: int) -> None:
        self.capacity = capacity
        self.model = copy.deepcopy(_compiled(write_mjcf(model), capacity))
        self.data = mujoco.MjData(self.model)
        self._arm_geoms = np.array([self.model.geom(name).id for name in geom_names(model)])
        self._pool = np.flatnonzero(self.model.body_mocapid[self.model.geom_bodyid] >= 0)
        self._obstacle_geoms: NDArray[np.int64] = np.empty(0, np.int64)
        self._segment = np.zeros(6)

    def place(self, obstacles: Obstacles) -> None:
        """Puts the pool where the obstacles are; what is left over takes part in nothing, and is not seen.

        Raises `ArmError` for more spheres or boxes than the capacity.
        """
        refuse_more(obstacles, self.capacity)
        spheres = obstacles.shapes == ObstacleShape.SPHERE
        slots = np.empty(len(spheres), np.int64)
        slots[spheres] = np.arange(spheres.sum())
        slots[~spheres] = self.capacity + np.arange((~spheres).sum())
        half = np.maximum(obstacles.sizes / 2, _THIN_M)
        self.data.mocap_pos[slots] = obstacles.positions
        self.data.mocap_quat[slots] = obstacles.quats
        self._obstacle_geoms = self._pool[slots]
        self.model.geom_size[self._obstacle_geoms] = half
        self.model.geom_rbound[self._obstacle_geoms] = np.where(spheres, half[:, 0], np.linalg.norm(half, axis=1))
        self.model.geom_aabb[self._obstacle_geoms] = np.concatenate([np.zeros_like(half), half], axis=1)
        self.model.geom_conaffinity[self._pool] = 0
        self.model.geom_conaffinity[self._obstacle_geoms] = 1
        self.model.geom_rgba[self._pool, 3] = 0.0
        self.model.geom_rgba[self._obstacle_geoms, 3] = _OPACITY

    def pose(self, q: NDArray[np.floating]) -> None:
        """Moves the arm to joint angles [J] (rad), and everything else to where it was placed."""
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)

    def measure(self, capsule: int, obstacle: int) -> Measured:
        """Distance between a capsule and an obstacle (rows) as they stand since `pose`.

        MuJoCo 4.0 now and then takes a capsule whose axis runs through a box for one beside it (15 in 100,000 random
        pairs): hold the answer against `narrow`.
        """
        distance = mujoco.mj_geomDistance(
            self.model,
            self.data,
            self._arm_geoms[capsule],
            self._obstacle_geoms[obstacle],
            _FAR_M,
            self._segment,
        )
        return Measured(float(distance), self._segment[:3].copy(), self._segment[3:].copy())


def refuse_more(obstacles: Obstacles, most: int) -> None:
    """Raises `ArmError` for more spheres or more boxes than that."""
    spheres = int((obstacles.shapes == ObstacleShape.SPHERE).sum())
    needed = max(spheres, len(obstacles.shapes) - spheres)
    if needed > most:
        raise ArmError(f"obstacles: expected at most {most} of a shape, found {needed}; raise max_obstacles")
