"""Solids: textured shapes at their place at one time, and whose they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.cell.actors import Body
from twin_node.cell.shapes import Form, Placed, Shape
from twin_node.cell.textures import Texture
from twin_node.geometry import pose
from twin_node.scene import Float64


@dataclass(frozen=True)
class Solid:
    """One primitive as it stands at one time."""

    placed: Placed
    texture: Texture
    owner: int
    """Index in `World.names` of the body, person or arm that it is part of."""


def body_solids(body: Body, T_base_body: Float64, owner: int) -> list[Solid]:
    """The parts of a body at pose [4, 4]."""
    return [Solid(Placed(part.shape, T_base_body @ part.T_body_part), part.texture, owner) for part in body.parts]


def sphere_at(center: Float64, radius: float, rotation: Float64) -> Placed:
    """A sphere about a point [3], m, turned by a rotation [3, 3]."""
    return Placed(Shape(Form.SPHERE, (radius,)), pose(rotation, center))


def capsule_between(start: Float64, end: Float64, radius: float, side: Float64) -> Placed:
    """A capsule about two points [3], m; its x axis, and with it its texture, faces as near to `side` [3] as it can."""
    axis = end - start
    length = float(np.sqrt(axis @ axis))
    z = axis / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    x = side - (side @ z) * z
    if x @ x < 1e-12:
        x = np.eye(3)[np.argmin(np.abs(z))]
        x -= (x @ z) * z
    x /= np.sqrt(x @ x)
    T = np.eye(4)
    T[:3, 0], T[:3, 2], T[:3, 3] = x, z, (start + end) / 2
    T[:3, 1] = z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]
    return Placed(Shape(Form.CAPSULE, (radius, length)), T)
