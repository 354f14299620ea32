"""The arm's kinematics and shapes, and what it hides from the cameras."""

from twin_node.robot.arms import arm_model
from twin_node.robot.kinematics import PlacedCapsules, forward_kinematics, place_capsules
from twin_node.robot.model import ArmModel, Capsules, RobotError
from twin_node.robot.self_filter import Outline, robot_mask, robot_outline
from twin_node.robot.ur import UR_NAMES, ur_dh, ur_model, ur_shape

__all__ = [
    "UR_NAMES",
    "ArmModel",
    "Capsules",
    "Outline",
    "PlacedCapsules",
    "RobotError",
    "arm_model",
    "forward_kinematics",
    "place_capsules",
    "robot_mask",
    "robot_outline",
    "ur_dh",
    "ur_model",
    "ur_shape",
]
