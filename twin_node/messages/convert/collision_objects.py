"""Obstacles as MoveIt's planning scene takes them: `moveit_msgs/msg/CollisionObject` on `/collision_object`."""

from __future__ import annotations

import numpy as np

from twin_node.messages.convert.markers import pose_message
from twin_node.messages.stamps import header
from twin_node.messages.types import Message, message_type
from twin_node.scene import Obstacles, ObstacleShape

COLLISION_OBJECT = "moveit_msgs/msg/CollisionObject"
ADD, REMOVE = 0, 1
"""Operations: an object of that name is added, or takes the place of the one before; and is taken away."""
_BOX, _SPHERE = 1, 2
"""Constants of `shape_msgs/SolidPrimitive`."""


def obstacles_to_collision_object(obstacles: Obstacles, name: str, frame: str) -> Message:
    """A CollisionObject of all the obstacles, which takes the place of the one of that name; none: it is taken away.

    `frame`: the name that `base_link` has in the planning scene.
    """
    primitive = message_type("shape_msgs/msg/SolidPrimitive")
    no_prism = message_type("geometry_msgs/msg/Polygon")(points=[])
    solids, poses = [], []
    for row in range(len(obstacles.ids)):
        is_sphere = obstacles.shapes[row] == ObstacleShape.SPHERE
        size = obstacles.sizes[row]
        dimensions = np.array([size[0] / 2]) if is_sphere else np.array(size, np.float64)
        solids.append(primitive(type=_SPHERE if is_sphere else _BOX, dimensions=dimensions, polygon=no_prism))
        poses.append(pose_message(obstacles.positions[row], obstacles.quats[row]))
    return message_type(COLLISION_OBJECT)(
        header=header(obstacles.stamp, frame),
        pose=pose_message(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])),
        id=name,
        type=message_type("object_recognition_msgs/msg/ObjectType")(key="", db=""),
        primitives=solids,
        primitive_poses=poses,
        meshes=[],
        mesh_poses=[],
        planes=[],
        plane_poses=[],
        subframe_names=[],
        subframe_poses=[],
        operation=ADD if solids else REMOVE,
    )
