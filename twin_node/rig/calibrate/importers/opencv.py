"""OpenCV: JSON lists of cameras with K, dist, R, t, and the files of its calibration samples (FileStorage)."""

from __future__ import annotations

import json
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

NOTES = "From OpenCV; its R, t map world to camera and are inverted here."


def import_opencv(path: Path, unit: float = 1.0) -> RigFile:
    """JSON `{"cameras": [{name, size, K, dist, R, t}]}`, or a FileStorage with one camera or a stereo pair.

    FileStorage: `camera_matrix, distortion_coefficients, image_width, image_height` (one camera), or `M1, D1, M2, D2,
    R, T, size` (a pair). Coefficients are those of `cv2.fisheye` where `fisheye` of a camera in JSON is true, or
    `fisheye_model` of a FileStorage is not 0.
    """
    if path.suffix.lower() == ".json":
        return foreign_rig(str(path), _json_cameras(path, unit), "world", NOTES)
    cameras = _storage_cameras(path, unit)
    return foreign_rig(str(path), cameras, f"{cameras[0].name}_optical_frame", NOTES)


def _json_cameras(path: Path, unit: float) -> list[RigCamera]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise RigError(f"{path}: expected cameras in JSON, found: {reason(error)}") from error
    cameras = []
    for fields in Fields(str(path), data).entries("cameras"):
        size = fields.array("size", (2,)).tolist()
        D = fields.list_of("dist")
        model = distortion_model(D, fields.flag("fisheye"))
        T = from_world_to_camera(fields.array("R", (3, 3)), _three(fields, "t") * unit)
        cameras.append(foreign_camera(fields.where, fields.text("name"), size, fields.array("K", (3, 3)), T, model, D))
    return cameras


def _three(fields: Fields, key: str) -> Float64:
    """[3] of a list, or of a column as OpenCV's own arrays are."""
    found = fields.list_of(key)
    return found if len(found) == 3 else fields.array(key, (3,))


def _storage_cameras(path: Path, unit: float) -> list[RigCamera]:
    try:
        path.open("rb").close()
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except OSError as error:
        raise RigError(f"{path}: expected a FileStorage of OpenCV (YAML or XML), found: {reason(error)}") from error
    except (cv2.error, SystemError) as error:
        raise RigError(f"{path}: expected a FileStorage of OpenCV (YAML or XML), found something else") from error
    is_fisheye = storage.getNode("fisheye_model").real() != 0
    if storage.getNode("M1").empty():
        size = [float(_numbers(path, storage, f"image_{side}", ())) for side in ("width", "height")]
        K, D = _numbers(path, storage, "camera_matrix", (3, 3)), _numbers(path, storage, "distortion_coefficients")
        return [foreign_camera(str(path), path.stem, size, K, np.eye(4), distortion_model(D, is_fisheye), D)]
    size = _numbers(path, storage, "size", (2,)).tolist()
    T = from_world_to_camera(_numbers(path, storage, "R", (3, 3)), _numbers(path, storage, "T", (3,)) * unit)
    cameras = []
    for name, number, pose in (("left", 1, np.eye(4)), ("right", 2, T)):
        K, D = _numbers(path, storage, f"M{number}", (3, 3)), _numbers(path, storage, f"D{number}")
        cameras.append(foreign_camera(f"{path}: {name}", name, size, K, pose, distortion_model(D, is_fisheye), D))
    return cameras


def _numbers(path: Path, storage: cv2.FileStorage, key: str, shape: tuple[int, ...] | None = None) -> Float64:
    """A field that holds finite numbers: a matrix, a sequence as `cv::Size` and vectors are written, or one number.

    `shape`: theirs, a row or column taken for a list; None: a list of any length.
    """
    node = storage.getNode(key)
    if node.empty():
        raise RigError(f"{path}: expected the field {key!r}, found none; is this a calibration of OpenCV's samples?")
    value = _value(node)
    wanted = "" if shape is None else f"{'x'.join(map(str, shape))} " if shape else "one of the "
    if value is None or not np.isfinite(value).all():
        found = "something else" if value is None else value.tolist()
        raise RigError(f"{path}: expected {wanted}finite numbers as {key!r}, found {found}")
    if shape is None or (len(shape) == 1 and value.ndim == 2 and 1 in value.shape):
        value = value.ravel()
    if shape is not None and value.shape != shape:
        found = "x".join(map(str, value.shape)) or "one number"
        raise RigError(f"{path}: expected {wanted}finite numbers as {key!r}, found {found}")
    return value


def _value(node: cv2.FileNode) -> Float64 | None:
    """What a node holds; None: no numbers."""
    if node.isInt() or node.isReal():
        return np.array(node.real())
    if node.isSeq():
        items = [node.at(i) for i in range(int(node.size()))]
        return np.array([item.real() for item in items]) if all(i.isInt() or i.isReal() for i in items) else None
    try:
        matrix = node.mat()
    except cv2.error:  # of a text, or of a mapping that is no matrix
        return None
    return None if matrix is None else np.asarray(matrix, dtype=np.float64)
