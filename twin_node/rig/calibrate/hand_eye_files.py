"""The stops of a hand-eye session as files: a list of images with flange poses or joint angles.

The layout is that of ROS-Industrial's `robot_cal_tools`: a list of `{image, pose}`, a pose being `{x, y, z, qx, qy, qz,
qw}` (m) in the file itself or in one of its own. `joints: [...]` (rad) may stand for `pose` where the arm is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from twin_node.errors import kind_of
from twin_node.geometry import pose, rotation_from_quat
from twin_node.picture_files import read_picture
from twin_node.rig.calibrate.board_files import checked, whole
from twin_node.rig.calibrate.boards import Board, CircleGrid
from twin_node.rig.calibrate.hand_eye import HandEyeView
from twin_node.rig.calibrate.intrinsics import usable
from twin_node.rig.calibrate.lenses import camera_matrix
from twin_node.rig.errors import RigError
from twin_node.rig.rig_checks import check_intrinsics
from twin_node.rig.yaml_fields import Fields
from twin_node.robot import ArmModel, forward_kinematics
from twin_node.scene import Float64, RigCamera, UInt8
from twin_node.yaml_file import read_yaml

LIST_FILE, LENS_FILES, TARGET_FILE = "cal_data.yaml", ("camera_intr_calibrated.yaml", "camera_intr.yaml"), "target.yaml"
"""What a folder holds: the list, the intrinsics (the first that is there) and the target."""


JOINT_SIGMA = np.radians(0.1)
"""1 sigma of a joint of an arm whose links are taken as its maker draws them, not as its factory measured them."""


@dataclass(frozen=True)
class Stop:
    """One stop of the robot: a picture and where the flange was."""

    image: Path
    T_base_flange: Float64
    """[4, 4]."""
    T_base_flange_off: Float64 | None = None
    """[J, 4, 4] the same were a joint off by `JOINT_SIGMA`, one after the other; None where the file tells the pose.
    Without the first and the last, which turn the whole base, or the flange, and so belong to what these are."""


def read_stops(path: Path, arm: ArmModel | None = None) -> tuple[Stop, ...]:
    """The stops that a list names, or that of a folder; paths are relative to it.

    Raises `RigError` for a file that is missing or wrong, naming the field.
    """
    file = path / LIST_FILE if path.is_dir() else path
    content = read_yaml(file, "a YAML file", RigError)
    if not isinstance(content, list) or not content:
        raise RigError(f"{file}: expected a list of {{image, pose}}, found {kind_of(content)}")
    return tuple(_stop(Fields(f"{file}[{i}]", entry), file.parent, arm) for i, entry in enumerate(content))


def stop_of_joints(image: Path, arm: ArmModel, joints: Float64) -> Stop:
    """The stop at joint angles [J], rad; its flange is the arm's `tool0`."""
    off = joints + JOINT_SIGMA * np.eye(arm.joints)[1:-1]
    links = (forward_kinematics(arm, angles)[..., -1, :, :] for angles in (joints, off))
    return Stop(image, *(link @ arm.T_last_tool for link in links))


def detect_target(
    stops: Sequence[Stop], board: Board, size: tuple[int, int], progress: Callable[[], object] | None = None
) -> tuple[HandEyeView, ...]:
    """The stops whose picture shows enough of the target to tell its pose, with its points' pixels.

    `size`: (width, height) of the images that the lens is calibrated for; `progress` is called after each. Raises
    `RigError` for a picture that cannot be read or is of another size.
    """
    views = []
    for stop in stops:
        picture = _grey(stop.image)
        if picture.shape != size[::-1]:
            raise RigError(
                f"{stop.image}: expected a picture of {size[0]}x{size[1]}, as the lens is calibrated for, found "
                f"{picture.shape[1]}x{picture.shape[0]}; use the calibration of this resolution"
            )
        found = board.detect(picture)
        if progress is not None:
            progress()
        if found is not None and usable(board, found):
            pixels = np.full((len(board.points), 2), np.nan)
            pixels[found.ids] = found.pixels
            views.append(HandEyeView(stop.image.stem, stop.T_base_flange, pixels, stop.T_base_flange_off))
    return tuple(views)


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of an image in pixels. Raises `RigError` where it cannot be read."""
    height, width = _grey(path).shape
    return width, height


def read_lens(folder: Path, size: tuple[int, int]) -> RigCamera:
    """The camera of a session's folder, of images of `size` (width, height), without distortion.

    Raises `RigError` where the folder has no intrinsics, or they are none of such images.
    """
    for name in LENS_FILES:
        if (folder / name).is_file():
            fields = Fields(str(folder / name), read_yaml(folder / name, "a YAML file", RigError)).table("intrinsics")
            K = camera_matrix(*(fields.number(key) for key in ("fx", "fy", "cx", "cy")))
            check_intrinsics(fields.where, K, size)
            return RigCamera("camera", size[0], size[1], K, np.eye(4))
    raise RigError(f"{folder}: expected {' or '.join(LENS_FILES)}, found neither; give --rig RIG.yaml")


def read_target(folder: Path) -> Board:
    """The target of a session's folder. Raises `RigError` where it has none, or one that is no grid of circles."""
    file = folder / TARGET_FILE
    if not file.is_file():
        raise RigError(f"{folder}: expected {TARGET_FILE}, found none; give --board")
    fields = Fields(str(file), read_yaml(file, "a YAML file", RigError)).table("target_finder")
    if "CircleGrid" not in fields.text("type"):
        raise RigError(f"{fields.where}.type: expected a grid of circles, found {fields.text('type')}; give --board")
    return checked(fields.where, CircleGrid(whole(fields, "cols"), whole(fields, "rows"), fields.number("spacing")))


def _stop(fields: Fields, folder: Path, arm: ArmModel | None) -> Stop:
    fields.only("image", "pose", "joints")
    image = folder / fields.text("image")
    if not image.is_file():
        raise RigError(f"{fields.where}.image: expected a file at {image}, found none; check the path")
    if fields.has("joints"):
        if arm is None:
            raise RigError(f"{fields.where}.joints: expected the arm to be known; give --arm (ur5e, ...)")
        return stop_of_joints(image, arm, fields.array("joints", (arm.joints,)))
    if fields.is_table("pose"):
        return Stop(image, _pose(fields.table("pose")))
    file = folder / fields.text("pose")
    return Stop(image, _pose(Fields(str(file), read_yaml(file, "a YAML file", RigError))))


def _pose(fields: Fields) -> Float64:
    quat = np.array([fields.number(key) for key in ("qw", "qx", "qy", "qz")])
    if abs(float(np.linalg.norm(quat)) - 1) > 1e-2:
        raise RigError(f"{fields.where}: expected a quaternion of length 1, found {np.linalg.norm(quat):.4g}")
    return pose(rotation_from_quat(quat), np.array([fields.number(key) for key in "xyz"]))


def _grey(path: Path) -> UInt8:
    image = read_picture(path, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise RigError(f"{path}: expected a picture, found a file that cannot be read as one; check the path")
    return np.asarray(image, dtype=np.uint8)
