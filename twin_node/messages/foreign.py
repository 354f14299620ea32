"""Types of other packages that are spoken beside the ROS 2 set, by their fields."""

from __future__ import annotations

DEFINITIONS = {
    "control_msgs/msg/SpeedScalingFactor": """
float64 factor
""",
    "object_recognition_msgs/msg/ObjectType": """
string key
string db
""",
    "moveit_msgs/msg/CollisionObject": """
byte ADD=0
byte REMOVE=1
byte APPEND=2
byte MOVE=3
std_msgs/Header header
geometry_msgs/Pose pose
string id
object_recognition_msgs/ObjectType type
shape_msgs/SolidPrimitive[] primitives
geometry_msgs/Pose[] primitive_poses
shape_msgs/Mesh[] meshes
geometry_msgs/Pose[] mesh_poses
shape_msgs/Plane[] planes
geometry_msgs/Pose[] plane_poses
string[] subframe_names
geometry_msgs/Pose[] subframe_poses
byte operation
""",
}
"""Message type -> definition. moveit_msgs as MoveIt 2 has them since Galactic, control_msgs as Jazzy has."""
