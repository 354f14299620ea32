"""ROS camera calibration files (camera_calibration_parsers' YAML), written and read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.rig.calibrate.lenses import Lens
from twin_node.rig.errors import RigError
from twin_node.rig.rig_checks import check_distortion, check_intrinsics, check_size, whole_coefficients
from twin_node.rig.yaml_fields import Fields
from twin_node.scene import Float64
from twin_node.yaml_file import read_yaml, write_yaml


@dataclass(frozen=True)
class CameraInfo:
    """What a calibration file says (sensor_msgs/CameraInfo)."""

    lens: Lens
    R: Float64
    """[3, 3] rectification."""
    P: Float64
    """[3, 4] projection of rectified points, pixels."""


def save_camera_info(lens: Lens, path: Path) -> None:
    """Writes a lens as `camera_info_manager` and `image_proc` read it; P is K, for images that are undistorted.

    What stands at `path` stays until the new file is whole. Raises `RigError` where it cannot be written.
    """
    P = np.concatenate([lens.K, np.zeros((3, 1))], axis=1)
    out = {
        "image_width": lens.width,
        "image_height": lens.height,
        "camera_name": path.stem,
        "camera_matrix": _matrix(lens.K),
        "distortion_model": lens.distortion_model,
        "distortion_coefficients": _matrix(lens.D[None]),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(P),
    }
    write_yaml(path, out, RigError)


def load_camera_info(path: Path) -> CameraInfo:
    """The content of a ROS camera calibration file. Raises `RigError` where it is none or a value is wrong."""
    fields = Fields(str(path), read_yaml(path, "a ROS camera calibration file", RigError))
    size = np.array([fields.number("image_width"), fields.number("image_height")])
    check_size(str(path), size)
    width, height = (int(value) for value in size)
    K = fields.table("camera_matrix").array("data", (9,)).reshape(3, 3)
    D = fields.table("distortion_coefficients").array("data", None)
    model = fields.text("distortion_model") or "plumb_bob"  # drivers leave it empty where nothing is distorted
    is_straight, D = not len(D), whole_coefficients(model, D)
    check_intrinsics(str(path), K, (width, height))
    check_distortion(str(path), model, D)
    if is_straight:  # a fisheye with coefficients of zero is not
        model, D = "plumb_bob", whole_coefficients("plumb_bob", np.zeros(0))
    R = _given(fields, "rectification_matrix", np.eye(3))
    P = _given(fields, "projection_matrix", np.concatenate([K, np.zeros((3, 1))], axis=1))
    if np.linalg.matrix_rank(P[:, :3]) < 3:
        raise RigError(
            f"{path}.projection_matrix: expected three columns of full rank, as of K, found {P[:, :3].tolist()}; leave "
            "it out where images are not rectified"
        )
    return CameraInfo(Lens(width, height, K, model, D), R, P)


def _given(fields: Fields, key: str, unknown: Float64) -> Float64:
    """A matrix of a file; `unknown` where it is missing, or zeros: what drivers write that do not know it."""
    if not fields.has(key):
        return unknown
    told = fields.table(key).array("data", (unknown.size,)).reshape(unknown.shape)
    return told if told.any() else unknown


def _matrix(values: Float64) -> dict[str, object]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}
