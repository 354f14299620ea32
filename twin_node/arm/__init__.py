"""From obstacles to the arm's speed: collision scene, checker, separation law."""

from twin_node.arm.errors import ArmError
from twin_node.arm.path import CycleParameters, CyclicPath, default_path, extrapolate, path_ahead, sample_path

__all__ = [
    "ArmError",
    "CycleParameters",
    "CyclicPath",
    "default_path",
    "extrapolate",
    "path_ahead",
    "sample_path",
]
