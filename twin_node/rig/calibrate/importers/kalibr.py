"""Kalibr's camera chains (`camchain.yaml`; github.com/ethz-asl/kalibr/wiki/yaml-formats)."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.importers.foreign_camera import foreign_camera, foreign_rig
from twin_node.rig.calibrate.lenses import camera_matrix
from twin_node.rig.errors import RigError
from twin_node.rig.rig_file import RigFile
from twin_node.rig.stamps import LATEST_S
from twin_node.rig.yaml_fields import Fields
from twin_node.scene import Float64, RigCamera
from twin_node.yaml_file import read_yaml

MODELS = {"radtan": "plumb_bob", "equidistant": "equidistant", "none": "plumb_bob"}


def import_kalibr(path: Path, unit: float = 1.0) -> RigFile:
    """A rig in the optical frame of cam0. Raises `RigError` for models other than pinhole-radtan and pinhole-equi."""
    data = read_yaml(path, "a camchain of Kalibr (YAML)", RigError)
    chain = Fields(str(path), data)
    cameras: list[RigCamera] = []
    T_rig_cam = np.eye(4)
    while chain.has(f"cam{len(cameras)}"):
        fields = chain.table(f"cam{len(cameras)}")
        if cameras:
            T_next_last = fields.array("T_cn_cnm1", (4, 4))
            T_next_last[:3, 3] *= unit
            T_rig_cam = T_rig_cam @ inverse_pose(T_next_last)
        camera = _camera(fields, f"cam{len(cameras)}", T_rig_cam)
        offset = fields.number("timeshift_cam_imu", 0.0)
        if abs(offset) > LATEST_S:
            raise RigError(f"{fields.where}.timeshift_cam_imu: expected seconds, found {offset:g}; correct it")
        cameras.append(replace(camera, time_offset_ns=round(offset * 1e9)))
    _check_all_read(path, data, len(cameras))
    return foreign_rig(str(path), cameras, "cam0_optical_frame", "From Kalibr; poses in the optical frame of cam0.")


def _check_all_read(path: Path, data: object, count: int) -> None:
    """Raises `RigError` for a camera that no other leads to; `count`: those that were read."""
    read = {f"cam{i}" for i in range(count)}
    for key in data if isinstance(data, dict) else ():
        if re.fullmatch(r"cam\d+", str(key)) and key not in read:
            raise RigError(f"{path}: expected cam{count} before {key}, found none; number the cameras without a gap")


def _camera(fields: Fields, name: str, T_rig_cam: Float64) -> RigCamera:
    model, lens = fields.text("camera_model"), fields.text("distortion_model")
    if model != "pinhole" or lens not in MODELS:
        raise RigError(
            f"{fields.where}: expected pinhole with {', '.join(MODELS)}, found {model} with {lens}; calibrate with "
            "pinhole-radtan or pinhole-equi"
        )
    K = camera_matrix(*fields.array("intrinsics", (4,)).tolist())
    D = np.zeros(0) if lens == "none" else fields.array("distortion_coeffs", (4,))
    return foreign_camera(fields.where, name, fields.array("resolution", (2,)).tolist(), K, T_rig_cam, MODELS[lens], D)
