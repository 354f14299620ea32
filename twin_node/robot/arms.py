"""Any arm by one name: a UR arm's, or a file's."""

from __future__ import annotations

from pathlib import Path

from twin_node.resources import find
from twin_node.robot.model import ArmModel
from twin_node.robot.ur import UR_NAMES, ur_model


def arm_model(name: str | Path) -> ArmModel:
    """Model of a UR arm ("ur5e"), or of the arm in an MJCF or URDF file ("my_arm.xml").

    Raises `RobotError` for a name that is neither, and for a file that holds no serial arm; `ResourceError` for a file
    that is not there.
    """
    if str(name) in UR_NAMES or not Path(name).suffix:
        return ur_model(str(name))
    from twin_node.robot.mjcf import load_arm  # MuJoCo takes a third of a second to import

    return load_arm(find(name))
