"""An arm that sweeps to its left, what stands beside its tool, and what is decided of both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from obstacle_sets import MS, NOW, Thing, obstacles

from twin_node.arm import ArmCollisionChecker, SeparationParameters, decide
from twin_node.robot import forward_kinematics
from twin_node.robot.ur import JOINT_NAMES
from twin_node.scene import JointPath, Separation

READY = np.array([0.0, -1.5, 1.5, -1.5, -1.57, 0.0])
REACTION_S = 0.06
TURNING = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""Joint velocities, rad/s: the arm sweeps to its left."""
SEEN = (-150, -150)
"""Validity of what was seen 150 ms ago, ms."""


def ahead(velocity: np.ndarray, begin: int = NOW) -> JointPath:
    offsets = np.arange(0, 201 * MS, 10 * MS)
    return JointPath(JOINT_NAMES, begin + offsets, READY + velocity * offsets[:, None] * 1e-9)


def beside_the_tool(checker: ArmCollisionChecker, left_m: float, **changes: object) -> Thing:
    """A ball of 10 cm whose surface is `left_m` to the left of the last link's origin."""
    tool = forward_kinematics(checker.model, READY)[-1, :3, 3]
    thing = Thing(tuple(tool + np.array([0.0, left_m + 0.05, 0.0])), size=(0.1,) * 3)
    return replace(thing, **changes)


def decided(checker: ArmCollisionChecker, *things: Thing, velocity: np.ndarray = TURNING, **law: object) -> Separation:
    checker.update(obstacles(*things))
    return decide(checker, ahead(velocity), NOW, REACTION_S, replace(SeparationParameters(), **law))


def decided_since(checker: ArmCollisionChecker, *things: Thing, velocity: np.ndarray = TURNING) -> Separation:
    """As `decided`, on evidence of 150 ms ago."""
    checker.update(obstacles(*things, stamp=NOW - 150 * MS))
    return decide(checker, ahead(velocity), NOW, REACTION_S)
