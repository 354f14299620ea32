"""Solids: textured shapes at their place at one time, and whose they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.cell.scenario import Body
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
    solids = []
    for part in body.parts:
        T = pose(Rotation.from_euler("xyz", part.rpy_deg, degrees=True).as_matrix(), np.array(part.position))
        solids.append(Solid(Placed(Shape(Form(part.form), part.size), T_base_body @ T), part.texture, owner))
    return solids


def sphere_at(center: Float64, radius: float, texture: Texture, owner: int) -> Solid:
    """A sphere about a point [3], m."""
    return Solid(Placed(Shape(Form.SPHERE, (radius,)), pose(np.eye(3), center)), texture, owner)


def capsule_between(start: Float64, end: Float64, radius: float, texture: Texture, owner: int) -> Solid:
    """A capsule whose end centres are two points [3], m; its texture turns least about its axis."""
    axis = end - start
    length = float(np.linalg.norm(axis))
    z = axis / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    side = np.eye(3)[np.argmin(np.abs(z))]
    x = np.cross(side, z)
    x /= np.linalg.norm(x)
    T = pose(np.stack([x, np.cross(z, x), z], axis=1), (start + end) / 2)
    return Solid(Placed(Shape(Form.CAPSULE, (radius, length)), T), texture, owner)
