"""Any arm by one name: a UR arm's, or a file's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from twin_node.resources import find
from twin_node.robot.factory_kinematics import with_factory_kinematics
from twin_node.robot.model import ArmModel, RobotError
from twin_node.robot.ur import UR_NAMES, ur_model

AIRO = "airo:"
"""Before the name of an arm of the package airo-models, whose capsules are fitted to detailed collision meshes."""


def ur_name(model: str) -> str | None:
    """The UR arm ("ur5e") that the name of a model stands for, as `arm_model` takes it; None: it is a file's."""
    name = model.removeprefix(AIRO)
    return name if name in UR_NAMES else None


def arm_model(
    name: str | Path, kinematics: str | Path | None = None, joint_names: Sequence[str] | None = None
) -> ArmModel:
    """Model of a UR arm ("ur5e"), of the arm in an MJCF or URDF file ("my_arm.xml"), or of airo-models' ("airo:ur5e").

    `kinematics` is a UR arm's own calibration file (see `with_factory_kinematics`). `joint_names`, from base to tool,
    picks the arm's joints of a file that has others too (see `load_arm`), and says how a UR arm's are called where its
    driver puts a prefix before them (`left_shoulder_pan_joint`). Raises `RobotError` for a name that is neither, for
    joints that the arm does not have, and for a file that holds no serial arm or another's calibration; `ResourceError`
    for a file that is not there.
    """
    if str(name).startswith(AIRO):
        name = _airo_file(str(name).removeprefix(AIRO))
    if not Path(name).suffix:
        model = _called(ur_model(str(name)), joint_names)
        return model if kinematics is None else with_factory_kinematics(model, kinematics)
    if kinematics is not None:
        raise RobotError(
            f"{kinematics}: expected a UR arm to calibrate, found {name}; its file says where its joints are"
        )
    from twin_node.robot.mjcf import load_arm  # MuJoCo takes a third of a second to import

    return load_arm(find(name), joint_names)


def _called(model: ArmModel, joint_names: Sequence[str] | None) -> ArmModel:
    """The same arm, its joints under other names."""
    if joint_names is None:
        return model
    own = model.joint_names
    is_prefixed = len(joint_names) == len(own) and all(map(str.endswith, joint_names, own))
    if not is_prefixed:
        raise RobotError(
            f"joints: expected those of {model.name} in this order, {', '.join(own)}, each with a prefix if its driver "
            f"gives it one, found {', '.join(joint_names)}; leave them out if there is none"
        )
    return replace(model, joint_names=tuple(joint_names))


def _airo_file(name: str) -> str:
    """URDF of an arm of airo-models. Raises `RobotError` where the package or the arm is missing."""
    try:
        import airo_models
    except ImportError:
        raise RobotError(
            f"{AIRO}{name}: expected the package airo-models; install it with pip install 'twin-node[models]'"
        ) from None
    arms = [known for known in airo_models.AIRO_MODEL_NAMES if known in UR_NAMES]
    if name not in arms:
        raise RobotError(f"{AIRO}{name}: expected {' or '.join(AIRO + arm for arm in arms)}")
    path: str = airo_models.get_urdf_path(name)
    return path
