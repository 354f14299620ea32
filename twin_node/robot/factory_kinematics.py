"""The kinematics that UR measured of one arm in the factory, as `ur_calibration` extracts them from the controller."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from twin_node.geometry import pose
from twin_node.robot.kinematics import forward_kinematics
from twin_node.robot.model import ArmModel, RobotError
from twin_node.scene import Float64
from twin_node.yaml_file import read_yaml

_SECTIONS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_FIELDS = ("x", "y", "z", "roll", "pitch", "yaw")
_PLAUSIBLE_M = 0.1
"""How far the tool at zero angles may be from where the DH parameters put it; another arm's file is farther off."""


def with_factory_kinematics(model: ArmModel, path: str | Path) -> ArmModel:
    """A UR arm's model with joint frames from its own calibration file instead of the published DH parameters.

    The file is the one that `ur_robot_driver`'s `ur_calibration` writes (`kinematics:` with x, y, z in metres and roll,
    pitch, yaw in radians per link). Without it the tool is off by millimetres. Raises `RobotError` for a file that
    lacks a value, and for one that belongs to another type of arm.
    """
    content = read_yaml(Path(path), "a UR calibration file (YAML)", RobotError)
    sections = content.get("kinematics") if isinstance(content, dict) else None
    origins = np.stack([_origin(sections, section, path) for section in _SECTIONS])
    origins[0] = np.diag([-1.0, -1.0, 1.0, 1.0]) @ origins[0]  # the file starts in `base`, as UR's controller does
    calibrated = replace(model, origins=origins)
    zeros = np.zeros(model.joints)
    tools = [forward_kinematics(arm, zeros)[-1, :3, 3] for arm in (calibrated, model)]
    shift = float(np.linalg.norm(tools[0] - tools[1]))
    if shift > _PLAUSIBLE_M:
        raise RobotError(
            f"{path}: expected the calibration of a {model.name}, found a tool {shift:.2f} m away from its place; "
            "take the file of this arm"
        )
    return calibrated


def _origin(sections: object, section: str, path: str | Path) -> Float64:
    """Pose [4, 4] of one joint in the link before it."""
    fields = sections.get(section) if isinstance(sections, dict) else None
    found = fields if isinstance(fields, dict) else {}
    wrong = [name for name in _FIELDS if not _is_number(found.get(name))]
    if wrong:
        raise RobotError(
            f"{path}: expected kinematics/{section} with numbers {', '.join(_FIELDS)}, found none for "
            f"{', '.join(wrong)}; extract the file again with ur_calibration"
        )
    numbers = [float(found[name]) for name in _FIELDS]
    from scipy.spatial.transform import Rotation  # loads slowly, and most processes that have an arm never ask

    return pose(Rotation.from_euler("xyz", numbers[3:]).as_matrix(), np.array(numbers[:3]))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
