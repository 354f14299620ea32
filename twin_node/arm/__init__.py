"""From obstacles to the arm's speed: collision scene, checker, separation law."""

from twin_node.arm.attachment import AllowedRegion, Attachment
from twin_node.arm.checker import Approaches, ArmCollisionChecker, Clearance
from twin_node.arm.course import Commands, Underway
from twin_node.arm.cycle import CycleParameters, CyclicPath, default_path
from twin_node.arm.decision import decide
from twin_node.arm.errors import ArmError
from twin_node.arm.limiter import LimiterParameters, SpeedLimiter, standing
from twin_node.arm.path import extrapolate, path_ahead, path_from_sample, sample_path
from twin_node.arm.predictor import ArmPredictor
from twin_node.arm.scene import CollisionScene
from twin_node.arm.self_collision import SelfClearance
from twin_node.arm.separation import SeparationParameters, UnknownPolicy
from twin_node.arm.stopping import StoppingTable, stopping_table
from twin_node.arm.tool import ToolCapsule, with_tool
from twin_node.arm.workspace import beyond

__all__ = [
    "AllowedRegion",
    "Approaches",
    "ArmCollisionChecker",
    "ArmError",
    "ArmPredictor",
    "Attachment",
    "Clearance",
    "CollisionScene",
    "Commands",
    "CycleParameters",
    "CyclicPath",
    "LimiterParameters",
    "SelfClearance",
    "SeparationParameters",
    "SpeedLimiter",
    "StoppingTable",
    "ToolCapsule",
    "Underway",
    "UnknownPolicy",
    "beyond",
    "decide",
    "default_path",
    "extrapolate",
    "path_ahead",
    "path_from_sample",
    "sample_path",
    "standing",
    "stopping_table",
    "with_tool",
]
