"""TOML of anipose, caliscope and Pose2Sim: a table per camera with matrix, distortions, rotation and translation."""

from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import numpy as np

from twin_node.errors import reason
from twin_node.rig.calibrate.importers.foreign_camera import (
    distortion_model,
    foreign_camera,
    foreign_rig,
    from_world_to_camera,
)
from twin_node.rig.errors import RigError
from twin_node.rig.rig_file import RigFile
from twin_node.rig.yaml_fields import Fields
from twin_node.scene import Float64, RigCamera


def import_toml(path: Path, unit: float = 1.0) -> RigFile:
    """Tables `[cam_0]` (anipose, Pose2Sim) or `[cameras.0]` (caliscope); `rotation` is a vector or a matrix."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RigError(f"{path}: expected a calibration in TOML, found: {reason(error)}") from error
    tables = {**data, **{f"cam_{key}": value for key, value in _table(data.get("cameras")).items()}}
    cameras = [
        _camera(Fields(f"{path}: {key}", value), key, unit)
        for key, value in tables.items()
        if "matrix" in _table(value) and not _table(value).get("ignore", False)
    ]
    return foreign_rig(str(path), cameras, "world", "From TOML; poses in that file's world.")


def _table(value: object) -> dict[str, object]:
    return value if isinstance(value, dict) else {}


def _camera(fields: Fields, key: str, unit: float) -> RigCamera:
    translation = fields.array("translation", (3,)) * unit
    D = fields.array("distortions", None)
    return foreign_camera(
        fields.where,
        fields.text("name", key),
        fields.array("size", (2,)).tolist(),
        fields.array("matrix", (3, 3)),
        from_world_to_camera(_rotation(fields), translation),
        distortion_model(D, fields.flag("fisheye")),
        D,
    )


def _rotation(fields: Fields) -> Float64:
    """[3, 3] of a Rodrigues vector or a matrix."""
    if fields.is_nested("rotation"):
        return fields.array("rotation", (3, 3))
    return np.asarray(cv2.Rodrigues(fields.array("rotation", (3,)))[0], np.float64)
