"""What every importer does at the end: from numbers of another tool to a checked camera of a rig."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_node.geometry import inverse_pose, pose
from twin_node.rig.errors import RigError
from twin_node.rig.rig_checks import (
    check_distortion,
    check_facing,
    check_intrinsics,
    check_pose,
    check_size,
    whole_coefficients,
)
from twin_node.rig.rig_file import RigFile
from twin_node.scene import Float64, Rig, RigCamera, as_camera_name


def from_world_to_camera(R: Float64, t: Float64) -> Float64:
    """`T_base_cam` [4, 4] of extrinsics x_cam = R x_world + t."""
    return inverse_pose(pose(R, t))


def distortion_model(D: Float64, is_fisheye: bool) -> str:
    """The model, as ROS names it, that coefficients in OpenCV's order belong to."""
    if is_fisheye:
        return "equidistant"
    return "plumb_bob" if len(np.trim_zeros(D, "b")) <= 5 else "rational_polynomial"


def foreign_camera(
    where: str, name: str, size: Sequence[float], K: Float64, T_base_cam: Float64, model: str, D: Float64
) -> RigCamera:
    """A camera of a rig; its name is made fit for topics. Raises `RigError` for values that no camera has.

    `size`: width and height as the file has them, in pixels.
    """
    D = whole_coefficients(model, D)
    check_size(where, np.array(size, dtype=np.float64))
    for what, values in (("K", K), ("distortion", D), ("pose", T_base_cam)):
        if not np.isfinite(values).all():
            raise RigError(f"{where}: expected finite numbers, found {what} {values.tolist()}; calibrate it again")
    width, height = int(size[0]), int(size[1])
    check_intrinsics(where, K, (width, height))
    check_distortion(where, model, D)
    check_pose(where, T_base_cam)
    return RigCamera(as_camera_name(name), width, height, K, T_base_cam, model, D)


def foreign_rig(where: str, cameras: Sequence[RigCamera], frame: str, notes: str) -> RigFile:
    """A rig file of imported cameras. Raises `RigError` where there are none, or they do not look at one volume."""
    if not cameras:
        raise RigError(f"{where}: expected at least one camera, found none; is this the right format?")
    names = tuple(camera.name for camera in cameras)
    for name in names:
        if names.count(name) > 1:
            raise RigError(f"{where}: expected cameras with distinct names, found {name!r} {names.count(name)} times")
    if len(cameras) > 1:
        check_facing(where, names, np.stack([camera.T_base_cam for camera in cameras]))
    return RigFile(Rig(tuple(cameras)), frame=frame, notes=notes)
