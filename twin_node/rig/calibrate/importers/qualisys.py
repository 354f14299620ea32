"""Qualisys Track Manager's calibration files (`*.qca.txt`, XML), whose cameras look along -z in mm."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from twin_node.errors import reason
from twin_node.geometry import pose
from twin_node.rig.calibrate.importers.foreign_camera import foreign_camera, foreign_rig
from twin_node.rig.calibrate.lenses import camera_matrix
from twin_node.rig.errors import RigError
from twin_node.rig.rig_file import RigFile
from twin_node.scene import Float64, RigCamera

SUBPIXELS = 64.0
"""Intrinsics are in 64ths of a pixel, and so is the distortion (as Pose2Sim reads it: github.com/perfanalytics)."""

MILLIMETRE = 1e-3


def import_qualisys(path: Path, unit: float = MILLIMETRE) -> RigFile:
    """Active cameras in Qualisys' world."""
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except (OSError, ElementTree.ParseError) as error:
        raise RigError(f"{path}: expected a calibration of Qualisys (XML), found: {reason(error)}") from error
    cameras = [
        _camera(path, element, unit)
        for element in root.iter("camera")
        if element.get("active", "1") not in ("0", "false")
    ]
    return foreign_rig(str(path), cameras, "world", "From Qualisys; poses in its world.")


def _camera(path: Path, element: ElementTree.Element, unit: float) -> RigCamera:
    name = element.get("serial", "")
    where = f"{path}: camera {name}"
    transform, intrinsic = _child(where, element, "transform"), _child(where, element, "intrinsic")
    video = _child(where, element, "fov_video")
    left, top = _number(where, video, "left"), _number(where, video, "top")
    size = (_number(where, video, "right") - left + 1, _number(where, video, "bottom") - top + 1)
    fu, fv = (_number(where, intrinsic, f"focalLength{axis}") / SUBPIXELS for axis in "UV")
    cu, cv = (_number(where, intrinsic, f"centerPoint{axis}") / SUBPIXELS for axis in "UV")
    D = np.array([_number(where, intrinsic, key) for key in _DISTORTION]) / SUBPIXELS
    return foreign_camera(
        where, name, size, camera_matrix(fu, fv, cu - left, cv - top), _pose(where, transform, unit), "plumb_bob", D
    )


_DISTORTION = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
"""Qualisys spells it so."""


def _pose(where: str, transform: ElementTree.Element, unit: float) -> Float64:
    """`T_base_cam`: rows of the file's matrix are the camera's x, y, z axes, y up and z backward."""
    R = np.array([[_number(where, transform, f"r{row}{column}") for column in (1, 2, 3)] for row in (1, 2, 3)])
    centre = np.array([_number(where, transform, axis) for axis in "xyz"]) * unit
    return pose(R.T @ np.diag([1.0, -1.0, -1.0]), centre)


def _child(where: str, element: ElementTree.Element, tag: str) -> ElementTree.Element:
    child = element.find(tag)
    if child is None:
        raise RigError(f"{where}: expected <{tag}>, found none; export the calibration again")
    return child


def _number(where: str, element: ElementTree.Element, key: str) -> float:
    text = element.get(key)
    try:
        number = float(text if text is not None else "")
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise RigError(f"{where}: expected a number in {element.tag}.{key}, found {text!r}")
    return number
