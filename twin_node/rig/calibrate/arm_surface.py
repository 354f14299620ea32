"""Points all over an arm's capsules, that images of it are compared with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.robot import Capsules
from twin_node.scene import Float64


@dataclass(frozen=True)
class ArmSurface:
    """Points of the surface, each in its link's frame."""

    points: Float64
    """[N, 3] m."""
    normals: Float64
    """[N, 3] outward."""
    links: NDArray[np.int64]
    """[N] whose it is."""


def arm_surface(capsules: Capsules, along: int, around: int) -> ArmSurface:
    """So many rings of so many points on each capsule, from one end of its axis to the other."""
    axis = capsules.ends[:, 1] - capsules.ends[:, 0]
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
    helper = np.where(np.abs(axis[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    side = np.cross(axis, helper)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    turns = np.arange(around) * 2 * np.pi / around
    normals = np.cos(turns)[:, None, None] * side + np.sin(turns)[:, None, None] * np.cross(axis, side)
    shares = np.linspace(0, 1, along)[:, None, None, None]
    spine = (1 - shares) * capsules.ends[:, 0] + shares * capsules.ends[:, 1]
    points = spine + capsules.radii[:, None] * normals
    links = np.broadcast_to(capsules.links, points.shape[:-1])
    return ArmSurface(points.reshape(-1, 3), np.broadcast_to(normals, points.shape).reshape(-1, 3), links.reshape(-1))
