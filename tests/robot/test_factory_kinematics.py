"""UR's calibration files: the nominal one changes nothing, a measured one moves the tool, a wrong one is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_node.robot import RobotError, forward_kinematics, ur_model
from twin_node.robot.factory_kinematics import with_factory_kinematics

NOMINAL_UR10E = """
kinematics:
  shoulder: {x: 0, y: 0, z: 0.1807, roll: -0, pitch: 0, yaw: -0}
  upper_arm: {x: 0, y: 0, z: 0, roll: 1.570796327, pitch: 0, yaw: -0}
  forearm: {x: -0.6127, y: 0, z: 0, roll: -0, pitch: 0, yaw: -0}
  wrist_1: {x: -0.57155, y: 0, z: 0.17415, roll: -0, pitch: 0, yaw: -0}
  wrist_2: {x: 0, y: -0.11985, z: -2.458164590756244e-11, roll: 1.570796327, pitch: 0, yaw: -0}
  wrist_3: {x: 0, y: 0.11655, z: -2.390480459346185e-11, roll: 1.57079632659, pitch: 3.14159265359, yaw: 3.14159265359}
  hash: calib_12788084448423163542
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "calibration.yaml"
    path.write_text(text)
    return path


def test_the_nominal_file_is_the_published_arm(tmp_path: Path) -> None:
    model = ur_model("ur10e")
    calibrated = with_factory_kinematics(model, written(tmp_path, NOMINAL_UR10E))
    q = np.random.default_rng(0).uniform(-3, 3, (50, 6))
    np.testing.assert_allclose(forward_kinematics(calibrated, q), forward_kinematics(model, q), atol=1e-8)


def test_a_measured_offset_moves_the_tool(tmp_path: Path) -> None:
    model = ur_model("ur10e")
    text = NOMINAL_UR10E.replace("x: -0.6127", "x: -0.6147")
    calibrated = with_factory_kinematics(model, written(tmp_path, text))
    shift = forward_kinematics(calibrated, np.zeros(6))[-1, :3, 3] - forward_kinematics(model, np.zeros(6))[-1, :3, 3]
    np.testing.assert_allclose(shift, [0.002, 0, 0], atol=1e-8)


def test_wrong_files_are_refused(tmp_path: Path) -> None:
    model = ur_model("ur10e")
    with pytest.raises(RobotError, match="calibration of a ur5e, found a tool"):
        with_factory_kinematics(ur_model("ur5e"), written(tmp_path, NOMINAL_UR10E))
    with pytest.raises(RobotError, match="expected kinematics/forearm with numbers"):
        with_factory_kinematics(model, written(tmp_path, NOMINAL_UR10E.replace("forearm", "fourarm")))
    wrong = "expected kinematics/shoulder with numbers .*, found none for z; extract"
    for number in (".nan", "-.inf", "1" + 400 * "0", "yes", "high"):
        with pytest.raises(RobotError, match=wrong):
            with_factory_kinematics(model, written(tmp_path, NOMINAL_UR10E.replace("z: 0.1807", f"z: {number}")))
    for text in ("[1, 2]", "", "kinematics: 3"):
        with pytest.raises(RobotError, match="expected kinematics/shoulder"):
            with_factory_kinematics(model, written(tmp_path, text))
    with pytest.raises(RobotError, match="expected a UR calibration file"):
        with_factory_kinematics(model, written(tmp_path, "kinematics: [1"))
    with pytest.raises(RobotError, match="expected a UR calibration file"):
        with_factory_kinematics(model, tmp_path / "nowhere.yaml")
